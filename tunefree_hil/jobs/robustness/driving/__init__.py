"""How the drives of a road sweep are made, here or on a cluster, and stored."""
