"""Tables and figure of replays, from MLflow alone."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from bench.cli import main
from bench.errors import InputError
from bench.outcomes.store import connect
from reports.streaming import draw, stream_of, write_streaming
from tests.conftest import runs
from tests.work.test_stream import SMALL


def test_tables_and_figure_are_rebuilt_from_the_store(tmp_path):
    assert main(["stream", *SMALL, "start=onset,middle"]) == 0
    store, parents = runs("stream")
    assert [p.data.params["stream.start"] for p in parents] == ["onset", "middle"]
    paths = write_streaming(store, [p.info.run_id for p in parents], tmp_path / "again")
    assert [p.name for p in paths] == ["streaming.csv", "stopping.csv", "streaming.png", "streaming.svg"]
    table = pd.read_csv("report/streaming.csv")
    assert table.equals(pd.read_csv(tmp_path / "again" / "streaming.csv"))
    assert set(table["start"]) == {"onset", "middle"} and table["synthetic"].all()
    last = table.groupby("start")["accuracy"].last()
    assert last["onset"] == pytest.approx(parents[0].data.metrics["accuracy"])
    assert (tmp_path / "again" / "streaming.png").stat().st_size > 10_000
    text = (tmp_path / "again" / "streaming.svg").read_text()
    assert "synth (synthetic)" in text and "from the middle" in text
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="choose another out="):
        write_streaming(store, [parents[0].info.run_id], tmp_path / "file" / "x")
    assert write_streaming(store, [], tmp_path / "none") == []
    row = stream_of(connect(), parents[0].info.run_id)
    assert row["adaptive"]["accuracy"] == parents[0].data.metrics["adaptive_accuracy"]


def test_systems_differ_without_colour_and_names_do_not_overlap():
    rows = []
    for i in range(5):
        ms = np.array([60.0, 200, 900])
        table = pd.DataFrame({"ms": ms, "mean_ms": ms, "accuracy": [0.2, 0.4, 0.5 + i / 50], "low": 0.1, "high": 0.6})
        about = {"system": f"system {i} with a long name · features[of=many, kinds=7]", "seed": "0", "data": "arm"}
        about |= {"subset": "all", "target": "gesture", "protocol_label": "LOSO (4 subjects)", "start": "onset"}
        point = {"mean_ms": 300.0, "accuracy": 0.4, "low": np.nan, "high": np.nan}
        rows.append(about | {"synthetic": "false", "instants": table, "stopping": table, "adaptive": point})
    fig = draw(rows)
    lines = fig.axes[0].get_lines()
    assert len({(line.get_linestyle(), line.get_marker()) for line in lines}) == 5
    FigureCanvasAgg(fig).draw()
    boxes = [t.get_window_extent() for t in fig.legends[0].get_texts()]
    assert len(boxes) == 8 and not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    assert not any(box.overlaps(ax.get_tightbbox()) for box in boxes for ax in fig.axes)
