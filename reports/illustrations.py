"""The figures that are kept with a run beside its tables."""

from __future__ import annotations

from pathlib import Path

from bench.result import Result


def illustrate(result: Result, folder: Path) -> None:
    """Draw the confusions of a cell, accuracy against touch seen of a stream, or the timeline of a watch."""
    from reports import details, figures, streaming, watching

    group = ", ".join(result.context)
    if result.kind == "cell":
        confusion = result.tables["confusion"].set_index("true")
        figure, caption = details.confusion_figure(confusion, result.method, group)
        figures.save(figure, folder, "confusion", group, caption)
    elif result.kind == "stream":
        streaming.figure([result], folder)
    elif result.kind == "watch" and result.get("background_minutes"):  # without background, there is no rate
        figure = watching.watching_figure([result])
        figures.save(figure, folder, "watching", group, watching.caption(result))
