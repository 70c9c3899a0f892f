"""What ``bench data show`` draws: mean pressure of gestures, film strips, captures in motion, a page with all of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.corpora.corpus import Corpus
from bench.corpora.survey import DURATIONS, PRESSURE, Survey
from bench.errors import InputError
from reports.figures import SYNTHETIC, Picture, mark, new_figure, plain, save, short
from reports.layout import Animation, Block, Heading, Table, Text, page

FILMED = 8  # frames of a strip
DRAWN = 24  # gestures of a figure
ACROSS = 7  # panels of a row
PER_S, IMAGES = 12.5, 100  # of the animation: images a second, and their largest number
TITLE = 1.3  # inches that a panel's title may take
ROWS = 200  # of a table of the page
COLOURS = "magma"
ROOT = 0.5  # colours follow the square root of the pressure, or light touch would all be black
INDEX, MOTION = "index.html", "motion.gif"


def write(corpus: Corpus, found: Survey, folder: Path, capture: int | None = None) -> list[Path]:
    """Write figures, the animation and a page that holds them all.

    Args:
        corpus: the captures.
        found: `bench.corpora.survey.survey` of them.
        folder: where the files go; it is made.
        capture: the one to animate, by its position in the whole corpus; None for a typical one of each gesture.

    Returns:
        The files.

    Raises:
        InputError: no such capture is among these.
    """
    if capture is not None:
        place(corpus, capture)
    folder.mkdir(parents=True, exist_ok=True)
    group = corpus.name + (" (synthetic)" if corpus.synthetic else "")
    chosen = list(found.typical.values())[:DRAWN] if capture is None else [capture]
    pictures = [pressure_figure(found, group, folder), film_figure(corpus, found, group, folder)]
    moving = animation(corpus, chosen, group, folder)
    index = folder / INDEX
    index.write_text(page([*_blocks(found, group), *pictures, moving], f"A look at {group}"), encoding="utf-8")
    return [*(path for picture in pictures for path in picture.paths), moving.path, index]


def place(corpus: Corpus, capture: int) -> int:
    """Position in these captures of one that is named by its position in the whole corpus.

    Raises:
        InputError: it is not among them.
    """
    found = np.flatnonzero(corpus.index == capture)
    if not len(found):
        raise InputError(
            f"capture={capture}: not among the {len(corpus)} captures looked at; "
            f"give a number such as {corpus.index[0]} ({corpus.index.min()} to {corpus.index.max()})"
        )
    return int(found[0])


def _left_out(gestures: list[str]) -> str:
    return f" {len(gestures) - DRAWN} more gestures are not drawn." if len(gestures) > DRAWN else ""


def pressure_figure(found: Survey, group: str, folder: Path) -> Picture:
    """Mean pressure on the grid, a panel for each gesture, all in the same colours.

    Args:
        found: with ``means``.
        group: the corpus, in words.
        folder: where the files go.
    """
    from matplotlib.colors import PowerNorm

    names, means = found.gestures[:DRAWN], found.means[:DRAWN]
    grid = means.shape[1:]
    across = min(ACROSS, len(names))
    down = -(-len(names) // across)
    wide, high = _panel(grid, 1.35)
    slot = max(wide, TITLE)
    size = (max(4.5, across * (slot + 0.15) + 1.15), down * (high + 0.36) + 0.45)
    figure, axes = new_figure(size, (down, across), (0.15, size[0] - across * (slot + 0.15), 0.3, 0.5), (0.15, 0.36))
    figure.suptitle(f"Mean pressure of each gesture, {plain([group])[0]}", fontsize=9, y=1 - 0.08 / size[1], va="top")
    norm = PowerNorm(ROOT, vmin=0, vmax=max(float(means.max()), 1e-9), clip=True)
    for ax, name, values in zip(axes.flat, plain(short(n, 20) for n in names), means, strict=False):
        image = ax.imshow(values, cmap=COLOURS, norm=norm, aspect="auto")
        ax.set_box_aspect(high / wide)
        ax.set_title(name, fontsize=8, pad=3)
        for taxel in found.odd_taxels.to_dict("records"):
            ax.plot(taxel["col"], taxel["row"], "x", color="cyan", markersize=5, markeredgewidth=1)
    for ax in axes.flat:
        ax.set(xticks=[], yticks=[])
    for ax in list(axes.flat)[len(names) :]:
        ax.set_axis_off()
    right = across * (slot + 0.15) + 0.15
    bar = figure.add_axes((right / size[0], 0.3 / size[1], 0.12 / size[0], min(size[1] - 0.8, 2.0) / size[1]))
    figure.colorbar(image, cax=bar).set_label("sensor value", fontsize=8)
    bar.tick_params(labelsize=7)
    crosses = " Crosses: taxels that the page calls odd." if len(found.odd_taxels) else ""
    caption = (
        "Mean pressure of all frames of each gesture. All panels have the same colours, which follow the square root "
        f"of the pressure.{crosses}{_left_out(found.gestures)}"
    )
    return save(figure, folder, "pressure", "pressure", group, caption)


def _panel(grid: tuple[int, int], side: float) -> tuple[float, float]:
    """Inches, width and height, of a picture of the grid; a single line of taxels is not too thin to see."""
    rows, cols = grid
    return max(side * cols / max(rows, cols), 0.3), max(side * rows / max(rows, cols), 0.3)


def film_figure(corpus: Corpus, found: Survey, group: str, folder: Path) -> Picture:
    """A typical capture of each gesture: frames evenly spaced in time, and below them the total pressure.

    Args:
        corpus: the captures.
        found: with ``typical``.
        group: the corpus, in words.
        folder: where the files go.
    """
    from matplotlib.colors import PowerNorm

    names = found.gestures[:DRAWN]
    gap = 1 / 12  # between two frames, as a share of one
    wide, high = _panel(corpus.grid, 0.95)
    across = FILMED * wide * (1 + gap) - gap * wide
    left, top, curve, between = 1.75, 0.5, 0.42, 0.42
    row = high + 0.05 + curve + between
    size = (left + across + 0.75, top + row * len(names) + 0.25)
    figure, _ = new_figure(size, (1, 1), title=f"A typical capture of each gesture, {plain([group])[0]}")
    figure.axes[0].remove()
    for i, (gesture, name) in enumerate(zip(names, plain(short(n, 19) for n in names), strict=True)):
        capture = found.typical[gesture]
        frames = corpus[place(corpus, capture)]
        ends = len(frames) / corpus.rate_hz
        shown = (len(frames) * (np.arange(FILMED) + 0.5) / FILMED).astype(int)  # the frame in the middle of each eighth
        bottom = size[1] - top - i * row - high
        most = max(float(frames[shown].max()), 1e-9)
        for j, frame in enumerate(frames[shown]):
            at = (left + j * wide * (1 + gap)) / size[0]
            ax = figure.add_axes((at, bottom / size[1], wide / size[0], high / size[1]))
            ax.imshow(frame, cmap=COLOURS, norm=PowerNorm(ROOT, vmin=0, vmax=most, clip=True), aspect="auto")
            ax.set(xticks=[], yticks=[])
        low = bottom - 0.05 - curve
        ax = figure.add_axes((left / size[0], low / size[1], across / size[0], curve / size[1]))
        total = frames.sum(axis=(1, 2), dtype=np.float64)
        times = (np.arange(len(frames)) + 0.5) / corpus.rate_hz
        ax.plot(times, total, color="tab:blue", linewidth=0.9, marker="." if len(frames) < 3 else None)
        ax.set(xlim=(0, ends), ylim=(min(0.0, float(total.min())), None))
        for spine in ("top", "right"):
            ax.spines[spine].set_visible(False)
        ax.vlines(times[shown], *ax.get_ylim(), color="0.8", linewidth=0.6, zorder=0)
        ax.tick_params(labelsize=6, length=2, pad=1.5)
        ax.yaxis.tick_right()
        ax.spines["left"].set_visible(False)
        ax.spines["right"].set_visible(True)
        ax.set_yticks([float(total.max())], [_value(total.max())])
        if i == len(names) - 1:
            ax.set_xlabel("s", fontsize=7, labelpad=1)
        about = _about(corpus, capture)
        words = [name, f"capture {capture}", f"subject {about['subject']}", f"colours 0 to {_value(most)}"]
        figure.text(0.12 / size[0], (bottom + high) / size[1], words[0], fontsize=9, va="top", weight="bold")
        below = "\n".join(plain(short(w, 30) for w in words[1:]))
        figure.text(0.12 / size[0], (bottom + high - 0.2) / size[1], below, fontsize=7, va="top", color="0.35")
    caption = (
        "The capture of each gesture that is nearest to the middle in duration, mean and highest pressure: "
        f"{FILMED} frames evenly spaced in time, in colours that follow the square root of "
        "the pressure, each row on a scale of its own, and below them the pressure summed "
        "over the taxels against seconds, with its largest value; grey lines stand at the frames."
        f"{_left_out(found.gestures)}"
    )
    return save(figure, folder, "films", "films", group, caption)


def _value(number: float) -> str:
    """A sensor value, or a sum of some, without an exponent where it is not huge."""
    return f"{number:.0f}" if 100 <= number < 1e7 else f"{number:.3g}"


def _about(corpus: Corpus, capture: int) -> dict:
    return corpus.captures.iloc[place(corpus, capture)].to_dict()


def animation(corpus: Corpus, captures: list[int], group: str, folder: Path) -> Animation:
    """Captures side by side as they went, at the speed of the touch; a shorter one waits for the longest.

    Args:
        corpus: the captures.
        captures: by their position in the whole corpus.
        group: the corpus, in words.
        folder: where the file goes.
    """
    from matplotlib.animation import PillowWriter
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import PowerNorm

    films = [corpus[place(corpus, c)] for c in captures]
    longest = max(map(len, films)) / corpus.rate_hz
    times = np.arange(max(2, min(IMAGES, round(longest * PER_S)))) * 1.0
    times *= longest / len(times)
    across = min(ACROSS, len(films))
    down = -(-len(films) // across)
    wide, high = _panel(corpus.grid, 1.3 if len(films) > 1 else 2.6)
    slot = max(wide, TITLE)
    size = (max(4.2, across * (slot + 0.15) + 0.15), down * (high + 0.5) + 0.6)
    spare = size[0] - across * (slot + 0.15)
    figure, axes = new_figure(size, (down, across), (spare / 2, spare / 2, 0.25, 0.7), (0.15, 0.5))
    FigureCanvasAgg(figure)
    if corpus.synthetic:
        mark(figure)
    clock = figure.text(0.08 / size[0], 1 - 0.08 / size[1], "", fontsize=9, va="top")
    images = []
    for ax, film, capture in zip(axes.flat, films, captures, strict=False):
        most = max(float(film.max()), 1e-9)
        norm = PowerNorm(ROOT, vmin=0, vmax=most, clip=True)
        images.append(ax.imshow(film[0], cmap=COLOURS, norm=norm, aspect="auto"))
        ax.set_box_aspect(high / wide)
        about = _about(corpus, capture)
        words = plain(
            [short(str(about["gesture"]), 20), f"subject {short(str(about['subject']), 12)}, to {_value(most)}"]
        )
        ax.set_title("\n".join(words), fontsize=7, pad=2)
    for ax in axes.flat:
        ax.set(xticks=[], yticks=[])
    for ax in list(axes.flat)[len(films) :]:
        ax.set_axis_off()
    path = folder / MOTION
    writer = PillowWriter(fps=len(times) / longest)
    with writer.saving(figure, str(path), dpi=80):
        for t in times:
            clock.set_text(f"{plain([group])[0]}   {t:5.2f} s of {longest:.2f} s")
            for image, film in zip(images, films, strict=True):
                at = int(t * corpus.rate_hz)
                image.set_data(film[min(at, len(film) - 1)])
                image.set_alpha(1.0 if at < len(film) else 0.25)
            writer.grab_frame()
    which = "a typical capture of each gesture" if len(captures) > 1 else f"capture {captures[0]}"
    caption = (
        f"In motion: {which}, at the speed of the touch; each on a colour scale of its own, pale where it is over."
    )
    if corpus.synthetic:
        caption += f" Synthetic: {SYNTHETIC}."
    return Animation(path, caption)


def _blocks(found: Survey, group: str) -> list[Block]:
    """Words and tables of the page."""
    about = [Text(f"{found.title}.")]
    if found.synthetic:
        about.append(Text(f"Synthetic: {SYNTHETIC}.", warning=True))
    said = f" Synthetic: {SYNTHETIC}." if found.synthetic else ""
    classes = ("Classes", f"Captures and subjects of each class of target={found.target}.", found.classes)
    tables = [
        *([] if found.target == "gesture" else [classes]),
        ("Durations", f"{DURATIONS.capitalize()}.", found.durations),
        ("Pressure", f"{PRESSURE.capitalize()}.", found.pressure),
        ("Gaps", f"{found.gap_lines()[0]}.", found.gaps),
        ("Taxels", f"{found.taxel_lines()[0]}.", found.odd_taxels),
        ("Duplicates", f"{found.duplicate_lines()[0]}.", found.duplicates),
    ]
    blocks: list[Block] = [Heading(f"A look at {group}", 1), *about]
    for heading, words, table in tables:
        words = words.removeprefix(f"{heading}: ")
        caption = words[0].upper() + words[1:] + said
        more = f" The first {ROWS} rows of {len(table)}." if len(table) > ROWS else ""
        shown = table.head(ROWS).map(lambda v: f"{v:.4g}" if isinstance(v, float) else str(v))
        blocks += [Heading(heading), Table(shown, caption + more) if len(table) else Text(caption)]
    return [*blocks, Heading("Figures")]
