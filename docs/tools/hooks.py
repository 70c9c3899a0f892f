"""MkDocs hooks: run the examples of every page and the notebooks, and put their output in.

An example that fails ends the build.
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
ROOT = TOOLS.parent.parent
sys.path[:0] = [str(TOOLS), str(ROOT)]

import examples  # noqa: E402

from bench.cli import main  # noqa: E402
from bench.grammar.options import load_commands  # noqa: E402

outputs: dict[str, list[str] | str] = {}  # of the blocks of a page, by its name


def copy_packages() -> None:
    """Copy the packages to where an installation has them: mkdocstrings looks there first."""
    package = ROOT / "build" / "package" / "bench"
    shutil.rmtree(package, ignore_errors=True)
    for folder in ("bench", "features", "models", "protocols", "reports"):
        target = package if folder == "bench" else package / folder
        shutil.copytree(ROOT / folder, target, ignore=shutil.ignore_patterns("__pycache__"))


copy_packages()


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Run all examples; add the pages of the notebooks and their pictures."""
    pages = [Path(file.abs_src_path) for file in files.documentation_pages() if file.abs_src_path]
    outputs.update(examples.run_pages(pages))
    if errors := [output for output in outputs.values() if isinstance(output, str)]:
        raise PluginError("\n".join(errors))
    for book in ("walk.ipynb", "own.ipynb"):
        for name, content in run_notebook(TOOLS.parent / book).items():
            files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Put the output of each block below it, or why it was not run."""
    of_page = iter(outputs.get(page.file.src_uri, ()))

    def with_output(match: re.Match[str]) -> str:
        block, output = examples.read_block(match), next(of_page)
        text = f"```{block.language}\n{block.text}```\n"
        if block.reason_not_run:
            reason = html.escape(block.reason_not_run)
            return f'{text}\n<p class="note">Not run for this page: {reason}.</p>\n'
        if not block.shows_output:
            return text
        shown = fence_output(cut_output(output, block))
        return f'{text}\n<div class="output" markdown>\n{shown}\n</div>\n'

    if page.file.src_uri in outputs:  # the notebook's page has its outputs
        markdown = examples.BLOCK.sub(with_output, markdown)
    return markdown.replace("<!-- help of every command -->", help_sections())


def help_sections() -> str:
    """A section for each command, with the output of its ``--help``."""
    sections = []
    for name in load_commands():
        with contextlib.redirect_stdout(io.StringIO()) as output:
            main([name, "--help"])
        sections.append(f"## bench {name}\n\n{fence_output(output.getvalue().rstrip())}\n")
    return "\n".join(sections)


def cut_output(output: str, block: examples.Block) -> str:
    """The lines of an output that a block shows, with a mark where some are left out."""
    lines = output.rstrip().split("\n")
    if block.lines and len(lines) > block.lines:
        is_first = block.end == "first"
        lines = [*lines[: block.lines], "…"] if is_first else ["…", *lines[-block.lines :]]
    return "\n".join(lines)


def fence_output(text: str) -> str:
    """Output as a block; sentences are wrapped as a terminal wraps them, tables are not."""
    lines = []
    for line in text.split("\n"):
        is_sentence = len(line) > 100 and "  " not in line and not {*"│┃━─"} & {*line}
        lines += textwrap.wrap(line, 100) if is_sentence else [line]
    return "\n".join(["````text", *lines, "````"])


def is_progress(output: dict) -> bool:
    """True if an output of a cell is a progress bar or a line of one."""
    has_picture = {"image/png", "image/svg+xml"} & {*output.get("data", {})}
    is_display = output["output_type"] == "display_data"
    return output.get("name") == "stderr" or (is_display and not has_picture)


def run_notebook(path: Path) -> dict[str, str | bytes]:
    """Run a notebook in a folder of its own; return its page and pictures by name.

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
        variables = dict(os.environ)
        os.environ.pop("MLFLOW_TRACKING_URI", None)
        os.environ.update(examples.make_environment(folder))
        try:
            NotebookClient(book, timeout=300, resources={"metadata": {"path": name}}).execute()
        except CellExecutionError as e:
            raise PluginError(f"{path.name}: {e}") from e
        finally:
            os.environ.clear()
            os.environ.update(variables)
        for cell in book.cells:
            for output in cell.get("outputs", []):  # Jupyter accepts results that it cannot show
                if output["output_type"] == "error":
                    raise PluginError(f"{path.name}: {output['ename']}: {output['evalue']}")
            cell["outputs"] = [o for o in cell.get("outputs", []) if not is_progress(o)]
        text, resources = MarkdownExporter().from_notebook_node(book)
    text = text.replace(str(folder.resolve()), "/home/you").replace(name, "/home/you")
    return {path.with_suffix(".md").name: text, **resources["outputs"]}
