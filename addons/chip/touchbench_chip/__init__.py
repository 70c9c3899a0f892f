"""Fitted systems as C99: contents (`tables`), files (`write`) and costs (`measure`)."""
