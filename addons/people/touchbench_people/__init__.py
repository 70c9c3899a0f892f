"""A new person or another sensor: protocols, adaptation, a command, a section of the report."""
