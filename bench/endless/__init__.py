"""Endless streams: systems that find touches in recordings and in frames as they come."""

DETECTOR = "filter"  # that of bench watch, unless told otherwise
RATES = (1, 5, 10, 60)  # false alarms per hour of background, at which missed touches are counted
