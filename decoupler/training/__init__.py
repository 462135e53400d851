"""Training of a model on labelled samples."""
