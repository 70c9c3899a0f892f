"""Protocols: scikit-learn splitters over captures; the folder is imported as `bench.protocols`.

`bench.plan.splits` has their interface.
"""

PARTS = {
    "loso": "bench.protocols.subjects:LOSO",
    "sessions": "bench.protocols.subjects:Sessions",
    "pairs": "bench.protocols.subjects:Pairs",
    "groupkfold": "bench.protocols.subjects:SubjectKFold",
    "challenge": "bench.protocols.challenge:Challenge",
    "kfold": "bench.protocols.captures:CaptureKFold",
    "holdout": "bench.protocols.captures:Holdout",
    "repeated_kfold": "bench.protocols.captures:RepeatedKFold",
    "leave_one_capture": "bench.protocols.captures:LeaveOneCapture",
    "within": "bench.protocols.captures:Within",
    "windows": "bench.protocols.windows:WindowKFold",
}
