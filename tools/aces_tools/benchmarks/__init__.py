"""What `aces bench` measures, one file a subject. Figures are ratios to peers in the same run."""
