"""Tables and figures, made from what MLflow holds and from the published numbers; nothing else is read."""
