"""Training with torch, the only place that imports it (design D6); what is trained runs without."""
