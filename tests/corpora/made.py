"""Small files in every format that is imported, right ones and wrong ones."""

import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.corpora.read import cost, cuddlebot, haart, table

HEADER = "subject,gesture,frame,place,a,b"
GOOD = ["ann,pat,0,arm,1,2", "ann,pat,1,arm,3,4"]


def read(path, **options):
    """A table of 1 x 2 taxels."""
    return table.read(path, **({"rate_hz": 50.0, "grid": "1x2", "full_scale": 1e9} | options))


READERS = {"cost": cost.read, "cuddlebot": cuddlebot.read, "haart": haart.read, "table": read}


def csv(folder, *rows, header=HEADER, name="my.csv", end="\n"):
    """A table of captures; rows without any are good ones."""
    text = "".join(row + end for row in (header, *(rows or GOOD)))
    (folder / name).write_bytes(text.encode("utf-8", "surrogateescape"))
    return folder / name


def parquet(folder, **columns):
    """The same as parquet, with other columns."""
    values = {"subject": ["ann"] * 2, "gesture": ["pat"] * 2, "frame": [0, 1]} | columns
    values |= {name: values.pop(name, default) for name, default in (("a", [1, 3]), ("b", [2, 4]))}
    pq.write_table(pa.table(values), folder / "my.parquet")
    return folder / "my.parquet"


def npz(folder, **arrays):
    """Two captures as arrays, with others; None leaves one out."""
    good = {"frames": np.ones((3, 1, 2)), "offsets": [0, 2, 3], "subject": ["ann", "bob"], "gesture": ["pat", "rub"]}
    np.savez(folder / "my.npz", **{name: a for name, a in (good | arrays).items() if a is not None})
    return folder / "my.npz"


def line(subject=1, variant=1, gesture=1, frame=1, values=None):
    """A line of CoST.csv."""
    return ",".join(map(str, [subject, variant, gesture, frame, *(values or range(64))]))


COST_HEADER = ", ".join([*cost.LABELS, *cost.CHANNELS])


def cost_csv(folder, *lines, end="\n", header=COST_HEADER):
    return csv(folder, *lines, header=header, name="CoST.csv", end=end)


def training_csv(*captures, frames=haart.FRAMES):
    """The training file of HAART: captures as (participant, gesture)."""
    rows = [f'ParticipantNo, "Substrate", "Cover", "Gesture",{",".join(haart.CELLS)}']
    for i, (who, gesture) in enumerate(captures):
        rows += [f"{who},curve,fur,{gesture}," + ",".join([str(i), str(t), *["5"] * 62]) for t in range(frames)]
    return "\n".join(rows) + "\n"


def held_out_csv(*captures, frames=haart.FRAMES):
    """The test file of HAART."""
    rows = [f"ParticipantID,Substrate,Cover,Gesture,Sequence,{','.join(haart.CELLS)}"]
    for i, (who, gesture) in enumerate(captures):
        rows += [f"{who},foam,none,{gesture},{t}," + ",".join([str(i), *["7"] * 62, "9"]) for t in range(1, frames + 1)]
    return "\n".join(rows) + "\n"


TRAINING, TESTING = training_csv(("P4", "pat")), held_out_csv(("T9", "rub"))


def archive(folder, *others, name="r.zip", at="{}", packing=zipfile.ZIP_DEFLATED, parts=None):
    """A release of HAART as a zip file: other members first."""
    parts = {"training.csv": TRAINING, "testWITHLABELS.csv": TESTING} if parts is None else parts
    with zipfile.ZipFile(folder / name, "w", packing) as packed:
        for member, content in [*others, *((at.format(k), v) for k, v in parts.items())]:
            packed.writestr(member, content)
    return folder / name
