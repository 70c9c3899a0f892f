"""Endless streams: systems that find touches in recordings and in frames as they come."""
