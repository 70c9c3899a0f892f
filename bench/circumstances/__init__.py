"""Circumstances, a file each: what is changed while a fitted system labels the test captures again."""

PARTS = {  # by their key of bench run
    "after": "bench.circumstances.instants:Instants",
    "under": "bench.circumstances.faults:Faults",
    "train_subjects": "bench.circumstances.subjects:Subjects",
}
