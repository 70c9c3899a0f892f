"""Values that several parts share, once."""

LABELS = "labels"  # table with the labels of all circumstances that need no more
CLEAN = "none"  # the fault of captures without one
SEVERITIES = 5  # of each fault
FALSE_ALARMS = 5.0  # per hour of background, which bench watch accepts on training subjects unless told otherwise
DETECTOR = "filter"  # of bench watch
RATES = (1, 5, 10, 60)  # false alarms per hour of background, at which missed touches are counted
NO_TOUCH = "notouch"  # class of background, where captures have it and no other is named
BUSY = 1.3  # wall time of the reference workload, by its time on the quiet machine, from which on a machine is busy
WIDTH = 100  # columns of help
FAULTS = "dead_taxels stuck_taxels dead_lines gain_drift offset_drift saturation noise fewer_bits dropped_frames "
FAULTS += "lower_rate time_jitter late_start early_end shift rotation smaller_grid cover"
