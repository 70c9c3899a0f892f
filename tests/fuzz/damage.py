"""What can happen to stored files: each function takes the paths that may be harmed, and harms one or two of them."""

import json
import os
import random
import shutil
from pathlib import Path


def flip(paths, rng):
    path = rng.choice(paths)
    content, times = bytearray(path.read_bytes()), path.stat()
    for _ in range(rng.choice([1, 1, 2, 8])):
        if content:
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    write(path, bytes(content), rng)
    if rng.random() < 0.5:
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def write(path, content, rng):
    """In place, or as another file of the same name."""
    if rng.random() < 0.5:
        path.unlink()
    path.write_bytes(content)


def cut(paths, rng):
    path = rng.choice(paths)
    os.truncate(path, rng.randrange(path.stat().st_size + 1))


def empty(paths, rng):
    write(rng.choice(paths), b"", rng)


def lengthen(paths, rng):
    path = rng.choice(paths)
    with path.open("ab") as file:
        file.write(rng.choice([b"\0", b" ", b"\n", path.read_bytes(), rng.randbytes(100)]))


def grow(paths, rng):
    os.truncate(rng.choice(paths), rng.choice([1 << 20, 1 << 33, 1 << 40]))  # a hole, which takes no place


def blank(paths, rng):
    path = rng.choice(paths)
    content = path.read_bytes()
    start = rng.randrange(len(content) + 1)
    write(path, content[:start] + bytes(len(content[start : start + 64])) + content[start + 64 :], rng)


def remove(paths, rng):
    path = rng.choice([*paths, *{p.parent for p in paths}])
    shutil.rmtree(path) if path.is_dir() else path.unlink()


def swap(paths, rng):
    one = rng.choice(paths)
    alike = [p for p in paths if p != one and (p.name == one.name or p.suffix == one.suffix)] or paths
    other, aside = rng.choice(alike), one.with_name("aside")
    one.rename(aside)
    if other != one:
        other.rename(one)
    aside.rename(other)


def swap_folders(paths, rng):
    one, other = rng.sample(sorted({p.parent for p in paths if p.name == "corpus.json"}), 2)
    one.rename(aside := one.with_name("aside"))
    other.rename(one)
    aside.rename(other)


def copy_over(paths, rng):
    one, other = rng.choice(paths), rng.choice(paths)
    if one != other:
        write(one, other.read_bytes(), rng)


def another_kind(paths, rng):
    path = rng.choice(paths)
    content = path.read_bytes()
    path.unlink()
    kind = rng.randrange(8)
    if kind == 0:
        path.mkdir()
    elif kind == 1:
        path.mkdir()
        (path / path.name).write_bytes(content)
    elif kind == 2:
        os.mkfifo(path)
    elif kind == 3:
        (path.parent / "moved").write_bytes(content)
        path.symlink_to("moved")
    else:
        path.symlink_to([path.name, "nothing", "/dev/zero", rng.choice(paths)][kind - 4])


def folder_as_link(paths, rng):
    folders = sorted({p.parent for p in paths if p.name == "corpus.json"})
    one, other = rng.choice(folders), rng.choice([*folders, Path("/"), Path("nothing")])
    one.rename(one.with_name("moved"))
    one.symlink_to(one.with_name("moved") if other == one else other)


ODD = [None, True, -1, 0, 10**400, float("nan"), 0.1, "", "x", "\ud800", "0" * 64, [], [1], {}, {"a": {}}]


def change_json(paths, rng):
    path = rng.choice([p for p in paths if p.suffix == ".json"])
    value = json.loads(path.read_text())
    for _ in range(rng.choice([1, 1, 2])):
        inside = value
        while isinstance(inside, dict | list) and inside:
            key = rng.choice(list(inside) if isinstance(inside, dict) else range(len(inside)))
            if not (isinstance(inside[key], dict | list) and inside[key]) or rng.random() < 0.4:
                break
            inside = inside[key]
        if not (isinstance(inside, dict | list) and inside):
            continue
        kind = rng.randrange(5)
        if kind == 0:
            inside.pop(key)
        elif kind == 1 and isinstance(inside, dict):
            inside[rng.choice(["extra", "name", "digest", "stored", "sum", "synthetic"])] = rng.choice(ODD)
        elif kind == 2 and isinstance(inside[key], int | float):
            inside[key] += rng.choice([1, -1, 0.5])
        elif kind == 3:
            inside[key] = rng.choice(ODD)
        else:
            value = rng.choice([[value], {"corpus": value}, *ODD])
            break
    path.write_text(json.dumps(value))


def other_json(paths, rng):
    path = rng.choice([p for p in paths if p.suffix == ".json" or p.name == "current"])
    text = ["", "null", "[" * 50_000, "{" * 9, '{"name": 1, "name": 2}', "9" * 5000, "../arm", "/", "0" * 16, "é" * 16]
    write(path, rng.choice([t.encode() for t in text] + [b"\xff\xfe", b"\0" * 16]), rng)


def change_table(paths, rng):
    """Rows and values of a table, with all that the file says about itself."""
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = rng.choice([p for p in paths if p.suffix == ".parquet"])
    whole = pq.read_table(path)
    frame = whole.to_pandas()
    column = rng.choice(list(frame))
    kind = rng.randrange(5)
    if kind == 0:
        frame = frame.sample(frac=1, random_state=rng.randrange(1000)).reset_index(drop=True)
    elif kind == 1:
        frame = frame.iloc[: rng.randrange(len(frame))]
    elif kind == 2:
        frame = pd.concat([frame, frame.iloc[:1]], ignore_index=True)
    elif kind == 3:
        frame = frame.drop(columns=column)
    else:
        frame[column] = frame[column] + frame[column]
    frame.attrs = {}
    changed = pa.Table.from_pandas(frame, preserve_index=False)
    path.unlink()
    pq.write_table(changed.replace_schema_metadata(whole.schema.metadata), path)


def change_array(paths, rng):
    import numpy as np

    path = rng.choice([p for p in paths if p.suffix == ".npy"])
    array = np.load(path)
    changes = [
        lambda: array[:-1],
        lambda: array + 1,
        lambda: array[::-1],
        lambda: array.astype(np.float64),
        lambda: array.astype(">i4"),
        lambda: array.reshape(-1),
        lambda: array[:0],
        lambda: np.concatenate([array, array]),
        lambda: array * 0,
    ]
    changed = rng.choice(changes)()
    path.unlink()
    np.save(path, changed)


def touch(paths, rng):
    path = rng.choice(paths)
    os.utime(path, (0, 0)) if rng.random() < 0.5 else write(path, path.read_bytes(), random.Random(0))


def undone(paths, rng):
    path = rng.choice(paths)
    content = path.read_bytes()
    write(path, content[::-1], rng)
    write(path, content, rng)


DAMAGE = [
    *(flip, flip, cut, empty, lengthen, grow, blank, remove, swap, swap_folders, copy_over, another_kind),
    *(folder_as_link, change_json, change_json, other_json, change_table, change_array, touch, undone),
]
