"""What a set of gains must keep on every road: limits, what a drive shows, and the judgement of several drives."""
