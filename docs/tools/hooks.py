"""What MkDocs does for this site: it runs the examples of every page and the notebook, and puts in what they print.

An example that fails ends the build. ``PAGES``, names with commas between them, are the only pages whose examples are
run then, and the notebook is not run either: for a quick look at the site.
"""

from __future__ import annotations

import contextlib
import html
import io
import os
import re
import shutil
import sys
import tempfile
import textwrap
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

TOOLS = Path(__file__).parent
sys.path[:0] = [str(TOOLS), str(TOOLS.parent.parent)]

import examples  # noqa: E402

from bench.cli import main  # noqa: E402
from bench.grammar.options import commands  # noqa: E402

printed: dict[str, list[str] | str] = {}


def lay_out() -> None:
    """Lay the packages out as an installation has them: mkdocstrings looks for its paths before any event."""
    package, skipped = (
        TOOLS.parent.parent / "build" / "package" / "bench",
        shutil.ignore_patterns("__pycache__"),
    )
    shutil.rmtree(package, ignore_errors=True)
    for folder in ("bench", "features", "models", "protocols", "reports"):
        target = package if folder == "bench" else package / folder
        shutil.copytree(TOOLS.parent.parent / folder, target, ignore=skipped)


lay_out()


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Run everything; add the page of the notebook and its pictures."""
    pages = [Path(file.abs_src_path) for file in files.documentation_pages() if file.abs_src_path]
    few = os.environ.get("PAGES", "").split(",") if "PAGES" in os.environ else None
    printed.update(
        examples.run(page for page in pages if few is None or examples.site_name(page) in few)
    )
    if few and (unknown := set(few) - set(printed)):
        raise PluginError(f"PAGES: there is no page {', '.join(sorted(unknown))}")
    if failed := [said for said in printed.values() if isinstance(said, str)]:
        raise PluginError("\n".join(failed))
    for name, content in notebook(TOOLS.parent / "walk.ipynb", runs=few is None).items():
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Put what the blocks of a page printed below them, and why a block was not run."""
    if (
        page.file.src_uri not in printed
    ):  # the notebook's, which has its outputs, or left out by PAGES
        return markdown.replace("<!-- help of every command -->", helped())
    outputs = iter(printed[page.file.src_uri])

    def replaced(match: re.Match[str]) -> str:
        block = examples.block(match)
        output = next(outputs)
        typed = f"```{block.language}\n{block.text}```\n"
        if block.left_out:
            return f'{typed}\n<p class="note">Not run for this page: {html.escape(block.left_out)}.</p>\n'
        return typed + (
            f'\n<div class="output" markdown>\n{fenced(cut(output, block))}\n</div>\n'
            if block.shown
            else ""
        )

    return examples.BLOCK.sub(replaced, markdown).replace(
        "<!-- help of every command -->", helped()
    )


def helped() -> str:
    """A section for each command, with what its ``--help`` prints."""
    parts = []
    for name in commands():
        with contextlib.redirect_stdout(io.StringIO()) as said:
            main([name, "--help"])
        parts.append(f"## bench {name}\n\n{fenced(said.getvalue().rstrip())}\n")
    return "\n".join(parts)


def cut(output: str, block: examples.Block) -> str:
    """The lines of an output that are shown, with a mark where some are left out."""
    lines = output.rstrip().split("\n")
    if not block.lines or len(lines) <= block.lines:
        return "\n".join(lines)
    return "\n".join(
        [*lines[: block.lines], "…"] if block.end == "first" else ["…", *lines[-block.lines :]]
    )


def fenced(text: str) -> str:
    """Output as a block that nothing in it can end; sentences are wrapped as a terminal wraps them, tables are not."""
    lines = []
    for line in text.split("\n"):
        sentence = len(line) > 100 and "  " not in line and not any(c in line for c in "│┃━─")
        lines += textwrap.wrap(line, 100) if sentence else [line]
    return "\n".join(["````text", *lines, "````"])


def progress(output: dict) -> bool:
    """Whether an output of a cell is a progress bar or a line of it."""
    shown = output.get("data", {})
    picture = {"image/png", "image/svg+xml"} & {*shown}
    return output.get("name") == "stderr" or (
        output["output_type"] == "display_data" and not picture
    )


def notebook(path: Path, runs: bool = True) -> dict[str, str | bytes]:
    """Run a notebook in a folder of its own, or leave it as it is; its page and pictures by name.

    Raises:
        PluginError: a cell raises.
    """
    import nbformat
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError
    from nbconvert import MarkdownExporter

    book = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        before = dict(os.environ)
        os.environ.pop("MLFLOW_TRACKING_URI", None)
        os.environ.update(examples.environment(folder))
        try:
            if runs:
                NotebookClient(book, timeout=300, resources={"metadata": {"path": name}}).execute()
        except CellExecutionError as e:
            raise PluginError(f"{path.name}: {e}") from e
        finally:
            os.environ.clear()
            os.environ.update(before)
        for cell in book.cells:  # one whose result cannot be shown is no failure for Jupyter
            for output in cell.get("outputs", []):
                if output["output_type"] == "error":
                    raise PluginError(f"{path.name}: {output['ename']}: {output['evalue']}")
        for cell in book.cells:  # progress is no result
            cell["outputs"] = [o for o in cell.get("outputs", []) if not progress(o)]
        text, resources = MarkdownExporter().from_notebook_node(book)
    text = text.replace(str(folder.resolve()), "/home/you").replace(name, "/home/you")
    return {path.with_suffix(".md").name: text, **resources["outputs"]}
