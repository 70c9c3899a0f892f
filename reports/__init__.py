"""Tables and figures, made only from the store and the published numbers."""
