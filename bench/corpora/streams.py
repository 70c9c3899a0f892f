"""A survey of recordings before any training: pressure, idle level, durations, gaps, and background that looks touched.

Pure functions of `Recordings`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.recordings import DOUBT, Recordings
from bench.corpora.survey import NAMED, Survey, blocks, survey, taxels_of

LOW = 0.25  # quantile of the mean pressure: background has its idle level there, touches their weak frames
PRESSURES = (
    "pressure is the mean reading of a frame: idle, lower quartile of background; touch, lower quartile of touches; "
    "above, background frames above touch"
)
GAP_LENGTHS = ("shortest", "tenth", "median", "longest")


@dataclass(frozen=True, eq=False)
class StreamSurvey:
    """Survey of recordings; prints as sentences and short tables. Pressure is the mean reading of a frame.

    Attributes:
        recordings: a row for each recording: its labels; ``minutes``, of which ``background`` and ``doubtful``;
            ``events``; ``idle``, lower quartile of the pressure of background; ``touch``, that of touches, of the
            subject where a recording has none; ``above``, percent of background frames above ``touch``.
        events: ``events``, ``subjects`` and seconds ``shortest``, ``median``, ``longest`` by gesture.
        seconds: durations of the touches of each gesture.
        gaps: seconds between two touches of a recording, float64 [gaps]; 0 where one follows another at once.
        brief: share of gaps of one or two frames.
        stretches: background above ``touch``, longest first: ``subject``, ``recording`` (position or name), ``start``
            and ``end`` in seconds, mean ``pressure``, and ``touch``.
        levels: pressure of each frame of each recording.
        captures: survey of the captures between all labels, with the class ``background``; its taxels are those of
            whole recordings, as a taxel may well rest in a short gap.
    """

    recordings: pd.DataFrame
    events: pd.DataFrame
    seconds: dict[str, np.ndarray]
    gaps: np.ndarray
    brief: float
    stretches: pd.DataFrame
    levels: list[np.ndarray]
    captures: Survey

    def gap_line(self) -> str:
        """Gaps between touches, in a sentence."""
        if not len(self.gaps):
            return "Gaps between touches: none"
        lengths = (self.gaps.min(), *np.quantile(self.gaps, (0.1, 0.5)), self.gaps.max())
        words = ", ".join(f"{name} {value:.2f} s" for name, value in zip(GAP_LENGTHS, lengths, strict=True))
        return f"Gaps between touches: {len(self.gaps)}; {words}; {100 * self.brief:.0f} % last at most two frames"

    def stretch_line(self) -> str:
        """Background with the pressure of touches, in a sentence."""
        minutes = self.recordings["background"].sum()
        share = 100 * float((self.stretches["end"] - self.stretches["start"]).sum()) / 60 / minutes if minutes else 0.0
        return (
            f"Background with the pressure of touches: {len(self.stretches)} stretches, {share:.1f} % of the "
            f"background; label frames {DOUBT} if they may be touch"
        )

    def taxel_lines(self) -> list[str]:
        """Odd taxels: a sentence, and the first examples."""
        return [line.replace("% of captures)", "% of recordings)") for line in self.captures.taxel_lines()]

    def __str__(self) -> str:
        tables = [self.recordings, self.events, self.stretches.head(NAMED)]
        recordings, events, stretches = (t.to_string(index=False, float_format=lambda v: f"{v:.4g}") for t in tables)
        parts = [recordings, events, self.gap_line(), f"{self.stretch_line()}\n{stretches}"]
        return "\n\n".join([*parts, "\n".join(self.taxel_lines())])

    __repr__ = __str__


def survey_recordings(recordings: Recordings, captures: Corpus) -> StreamSurvey:
    """Survey recordings.

    Args:
        recordings: some recordings.
        captures: result of `bench.corpora.recordings.captures_in` for them.
    """
    corpus, rate_hz = recordings.corpus, recordings.corpus.rate_hz
    ends = np.cumsum(corpus.lengths)
    every = np.concatenate([frames.mean(axis=1, dtype=np.float64) for _, frames in blocks(corpus)])
    labels = recordings.frame_labels()
    background, touched = labels == "", ~np.isin(labels, ["", DOUBT])
    subjects = np.repeat(recordings.subjects, corpus.lengths)
    names = corpus.captures.get("recording", pd.Series(range(len(recordings))))
    rows, stretches = [], []
    for i, (begin, end) in enumerate(zip(ends - corpus.lengths, ends, strict=True)):
        level, quiet, mine = every[begin:end], background[begin:end], touched[begin:end]
        weak = level[mine] if mine.any() else every[touched & (subjects == recordings.subjects[i])]
        idle, touch = (float(np.quantile(some, LOW)) if len(some) else np.nan for some in (level[quiet], weak))
        above = quiet & (level > touch)  # nowhere, if no touch is known
        share = 100 * above.sum() / quiet.sum() if quiet.any() else np.nan
        rows.append((idle, touch, share))
        edges = np.flatnonzero(np.diff(np.concatenate([[False], above, [False]])))
        for start, stop in edges.reshape(-1, 2):
            about = recordings.subjects[i], names.iloc[i], start / rate_hz, stop / rate_hz
            stretches.append((*about, level[start:stop].mean(), touch))
    table = corpus.captures.drop(columns="gesture").astype(str)
    doubtful = (recordings.doubtful["end"] - recordings.doubtful["start"]).groupby(recordings.doubtful["recording"])
    events = recordings.events
    table = table.assign(
        minutes=corpus.lengths / rate_hz / 60,
        background=recordings.background_frames() / rate_hz / 60,
        doubtful=doubtful.sum().reindex(range(len(recordings)), fill_value=0).to_numpy() / rate_hz / 60,
        events=events["recording"].value_counts().reindex(range(len(recordings)), fill_value=0).to_numpy(),
    )
    seconds = ((events["end"] - events["start"]) / rate_hz).groupby(events["gesture"])
    lengths = seconds.agg(events="size", shortest="min", median="median", longest="max")
    people = pd.Series(recordings.subjects[events["recording"]], dtype=object).groupby(events["gesture"]).nunique()
    lengths.insert(1, "subjects", people)
    next_, same = events.shift(-1), events["recording"] == events["recording"].shift(-1)
    gaps = (next_["start"] - events["end"])[same].to_numpy(np.float64)
    columns = ["subject", "recording", "start", "end", "pressure", "touch"]
    found = pd.DataFrame(stretches, columns=columns)
    longest = (found["start"] - found["end"]).sort_values(kind="stable").index
    return StreamSurvey(
        recordings=table.assign(**dict(zip(("idle", "touch", "above"), np.array(rows).T, strict=True))),
        events=lengths.rename_axis("gesture").reset_index(),
        seconds={str(name): part.to_numpy() for name, part in seconds},
        gaps=gaps / rate_hz,
        brief=float((gaps <= 2).mean()) if len(gaps) else 0.0,
        stretches=found.loc[longest].reset_index(drop=True),
        levels=np.split(every, ends[:-1]),
        captures=replace(survey(captures), taxels=taxels_of(corpus)),
    )
