"""Small files in every format that is imported, right ones and wrong ones; small corpora."""

import zipfile

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from bench.corpora.corpus import Corpus
from bench.corpora.read import cost, cuddlebot, haart, table

HEADER = "subject,gesture,frame,place,a,b"
GOOD = ["ann,pat,0,arm,1,2", "ann,pat,1,arm,3,4"]


def read(path, **options):
    """A table of 1 x 2 taxels."""
    return table.read(path, **({"rate_hz": 50.0, "grid": "1x2", "full_scale": 1e9} | options))


READERS = {"cost": cost.read, "cuddlebot": cuddlebot.read, "haart": haart.read, "table": read}


def raw(folder, name, content):
    """A file with this content."""
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_bytes(
        content if isinstance(content, bytes) else content.encode("utf-8", "surrogateescape")
    )
    return folder / name


def csv(folder, *rows, header=HEADER, name="my.csv", end="\n"):
    """A table of captures; rows without any are good ones."""
    return raw(folder, name, "".join(row + end for row in (header, *(rows or GOOD))))


def parquet(folder, **columns):
    """The same as parquet, with other columns."""
    values = {"subject": ["ann"] * 2, "gesture": ["pat"] * 2, "frame": [0, 1]} | columns
    values |= {name: values.pop(name, default) for name, default in (("a", [1, 3]), ("b", [2, 4]))}
    pq.write_table(pa.table(values), folder / "my.parquet")
    return folder / "my.parquet"


def npz(folder, **arrays):
    """Two captures as arrays, with others; None leaves one out."""
    good = {
        "frames": np.ones((3, 1, 2)),
        "offsets": [0, 2, 3],
        "subject": ["ann", "bob"],
        "gesture": ["pat", "rub"],
    }
    np.savez(folder / "my.npz", **{name: a for name, a in (good | arrays).items() if a is not None})
    return folder / "my.npz"


def line(subject=1, variant=1, gesture=1, frame=1, values=None):
    """A line of CoST.csv."""
    return ",".join(map(str, [subject, variant, gesture, frame, *(values or range(64))]))


COST_HEADER = ", ".join([*cost.LABELS, *cost.CHANNELS])


def cost_csv(folder, *lines):
    return csv(folder, *lines, header=COST_HEADER, name="CoST.csv")


def training_csv(*captures):
    """The training file of HAART: captures as (participant, gesture)."""
    rows = [f'ParticipantNo, "Substrate", "Cover", "Gesture",{",".join(haart.CELLS)}']
    for i, (who, gesture) in enumerate(captures):
        rows += [f"{who},curve,fur,{gesture},{i},{t}" + ",5" * 62 for t in range(haart.FRAMES)]
    return "\n".join(rows) + "\n"


def held_out_csv(*captures):
    """The test file of HAART."""
    rows = [f"ParticipantID,Substrate,Cover,Gesture,Sequence,{','.join(haart.CELLS)}"]
    for i, (who, gesture) in enumerate(captures):
        rows += [
            f"{who},foam,none,{gesture},{t},{i}{',7' * 62},9" for t in range(1, haart.FRAMES + 1)
        ]
    return "\n".join(rows) + "\n"


RELEASE = {
    "training.csv": training_csv(("P4", "pat")),
    "testWITHLABELS.csv": held_out_csv(("T9", "rub")),
}


def archive(folder, packing=zipfile.ZIP_DEFLATED, name="r.zip", parts=RELEASE):
    """Files in a zip archive, such as the release of HAART."""
    with zipfile.ZipFile(folder / name, "w", packing) as packed:
        for member, content in parts.items():
            packed.writestr(member, content)
    return folder / name


SESSION = "150505-2coverdynamicpat.csv"  # a file of CuddleBot


def copied(corpus, pairs, **fields):
    """The corpus with captures replaced by copies of others, given as (place, copied one)."""
    arrays = list(corpus)
    for place, of in pairs:
        arrays[place] = arrays[of].copy()
    fields = {"full_scale": corpus.full_scale, "name": corpus.name} | fields
    return Corpus.from_captures(arrays, corpus.captures, corpus.rate_hz, **fields)


def study(name, people=("1", "2"), classes=("pat", "rub"), shape=(4, 5), rate_hz=40.0, **columns):
    """A corpus of one capture of each class and person, up to 1."""
    rng = np.random.default_rng([ord(letter) for letter in name])
    rows = [(who, what) for who in people for what in classes]
    captures = pd.DataFrame(rows, columns=["subject", "gesture"]).assign(**columns)
    arrays = [rng.random((8 + i, *shape)).astype(np.float32) for i in range(len(rows))]
    return Corpus.from_captures(
        arrays, captures, rate_hz, full_scale=1.0, name=name, info={"format": "table"}
    )
