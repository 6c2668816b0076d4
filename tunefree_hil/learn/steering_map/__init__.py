"""The learned steering map: steady wheel angle and side-slip over speed and curvature (control/steering_map.py)."""
