"""The commands, a file each: its keys and help, its function for Python, and what it prints."""

PARTS = {
    "run": "bench.commands.run:RUN",
    "choose": "bench.commands.choose:COMMAND",
    "report": "bench.commands.report:COMMAND",
    "data": "bench.commands.data:COMMAND",
    "fit": "bench.commands.fit:COMMAND",
    "compare": "bench.commands.compare:COMMAND",
    "stress": "bench.commands.run:STRESS",
    "tune": "bench.commands.tune:COMMAND",
    "audit": "bench.commands.audit:COMMAND",
    "ui": "bench.commands.ui:COMMAND",
    "predict": "bench.commands.predict:COMMAND",
    "runs": "bench.commands.runs:COMMAND",
    "check": "bench.commands.check:COMMAND",
}
