"""VectorNav's sentences."""
