"""Work in a forked process whose time and memory are limited."""

import multiprocessing
import resource
import traceback
from pathlib import Path

from bench.corpora.library import import_corpus
from bench.errors import InputError

ADDRESSES = 8 << 30  # bytes of address space that an import may ask for, used or not


def bounded(work, *arguments, seconds=90.0, mib=1400.0):
    """What ``work`` returns.

    Raises:
        AssertionError: it takes longer, needs more memory, or ends with an error.
    """
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_worked, args=(there, work, arguments))
    process.start()
    there.close()
    try:
        assert here.poll(seconds), f"no end after {seconds:g} s"
        result, error, used = here.recv()
    except EOFError:
        raise AssertionError("the process died") from None
    finally:
        process.kill()
        process.join()
    assert not error, error
    assert used <= mib, f"{used:.0f} MiB"
    return result


def _worked(pipe, work, arguments):
    before = _memory("VmRSS")
    size = int(1024 * 1024 * _memory("VmSize")) + ADDRESSES
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    Path("/proc/self/clear_refs").write_text("5")  # forgets the peak
    try:
        result, error = work(*arguments), ""
    except BaseException:
        result, error = None, traceback.format_exc()[-3000:]
    pipe.send((result, error, _memory("VmHWM") - before))


def _memory(name):
    """MiB of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(f"{name}:"))


def imported(kind, path, options):
    """Import a file: its frames, lengths and columns, or the one line that refuses it."""
    try:
        corpus = import_corpus(kind, Path(path), options)
    except InputError as e:
        message = str(e)
        assert len(message) <= 300 and message.isprintable(), message[:2000]
        return message
    return corpus.frames.copy(), corpus.lengths.tolist(), corpus.captures
