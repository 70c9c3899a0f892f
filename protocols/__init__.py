"""Training and test captures: scikit-learn splitters over captures.

What the harness may ask of one stands in `bench.plan.splits`.
"""

PARTS = {
    "loso": "bench.protocols.subjects:LOSO",
    "groupkfold": "bench.protocols.subjects:SubjectKFold",
    "challenge": "bench.protocols.challenge:Challenge",
    "kfold": "bench.protocols.captures:CaptureKFold",
    "holdout": "bench.protocols.captures:Holdout",
    "repeated_kfold": "bench.protocols.captures:RepeatedKFold",
    "leave_one_capture": "bench.protocols.captures:LeaveOneCapture",
    "within": "bench.protocols.captures:Within",
    "windows": "bench.protocols.windows:WindowKFold",
}
