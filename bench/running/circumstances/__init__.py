"""Circumstances, a file each: what is changed while a fitted system labels the test captures again."""

PARTS = {  # by their key of bench run
    "after": "bench.running.circumstances.instants:Instants",
    "under": "bench.running.circumstances.faults:Faults",
    "train_subjects": "bench.running.circumstances.subjects:Subjects",
}
