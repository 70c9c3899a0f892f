"""A new person or another sensor: protocols, adaptation of systems, a command, a section of the report."""
