"""Names of the faults, apart from `bench.corpora.faults`, so that help need not load SciPy."""

FAULT_NAMES = (
    *("dead_taxels", "stuck_taxels", "dead_lines", "gain_drift", "offset_drift", "saturation"),
    *("noise", "fewer_bits", "dropped_frames", "lower_rate", "time_jitter", "late_start"),
    *("early_end", "shift", "rotation", "smaller_grid", "cover"),
)
# only by name: not part of `ALL_FAULTS`
MORE_FAULT_NAMES = ("vibration", "drift", "noisy_region", "doubled_frames", "own_noise")
SHORTENING_FAULTS = ("late_start", "early_end")  # they remove an end
NO_FAULT = "none"
ALL_FAULTS = "all"
SEVERITIES = 5  # of each fault
