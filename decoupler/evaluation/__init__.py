"""Errors of a model, and what they are held against."""
