"""Values that several parts share, once."""

LABELS = "labels"  # table with the labels of all circumstances that need no more
CLEAN = "none"  # the fault of captures without one
ALL = "all"  # names of all faults
SEVERITIES = 5  # of each fault
BUSY = 1.3  # wall time of the reference workload, by its time on the quiet machine, from which on a machine is busy
SATURATED = 10  # one of so many taxels at full scale saturates a frame; not tuned
