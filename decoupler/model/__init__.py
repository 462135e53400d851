"""A trained model: ohms in, newtons and their deviations out, and its file."""
