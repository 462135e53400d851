"""The array's response turned around: forces from resistances, and the limit that noise sets."""
