"""Downloads against a server on this machine that redirects, breaks off, is busy or wrong."""

import hashlib
import re
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from bench.corpora import download
from bench.corpora.download import download_source
from bench.corpora.sources import COST, Source
from bench.errors import InputError
from bench.ground.scratch import data_folder

PIECE = 15 * download.CHUNK  # bytes
CONTENT = np.random.default_rng(0).bytes(3_000_000)


class Server(BaseHTTPRequestHandler):
    """Answers with the next status of ``plan``, then with the file, whose part may be asked for."""

    plan: list = []  # a status, or the number of bytes after which the connection ends
    asked: list = []  # the Range of each request
    tag = '"first"'
    headers_of_busy: dict = {}

    def do_GET(self):
        """Answer one request."""
        cls = type(self)
        cls.asked.append(self.headers.get("Range"))
        step = cls.plan.pop(0) if cls.plan else None
        if self.path == "/moved":
            return self._answer(302, {"Location": "/file"})
        if self.path == "/files":
            names = f'[{{"name": "CoST.csv", "download_url": "{cls.address}/file"}}]'
            return self._answer(200, {}, names.encode())
        if step in (404, 416, 429, 500):
            return self._answer(step, cls.headers_of_busy)
        first = 0
        wanted = re.fullmatch(r"bytes=(\d+)-", self.headers.get("Range") or "")
        if wanted and self.headers.get("If-Range") == cls.tag:
            first = int(wanted[1])
        head = {"Content-Length": str(len(CONTENT) - first), "ETag": cls.tag}
        if first:
            head["Content-Range"] = f"bytes {first}-{len(CONTENT) - 1}/{len(CONTENT)}"
        self._answer(206 if first else 200, head, CONTENT[first : step and first + step])

    def _answer(self, status, head, body=b""):
        self.send_response(status)
        for name, value in head.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        """Say nothing."""


@pytest.fixture
def server(monkeypatch, tmp_path):
    """A server; pauses are short."""
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path))
    monkeypatch.setattr(download, "PAUSE", 0)
    httpd = ThreadingHTTPServer(("127.0.0.1", 0), Server)
    Server.plan, Server.asked, Server.tag, Server.headers_of_busy = [], [], '"first"', {}
    Server.address = f"http://127.0.0.1:{httpd.server_port}"
    threading.Thread(target=httpd.serve_forever, daemon=True).start()
    yield Server
    httpd.shutdown()
    httpd.server_close()


def get(server, path="/file"):
    """Download the file; return its digest."""
    source = Source("release.zip", server.address + path, "", "", "", "", "a page")
    file = download_source(source, "made")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    file.unlink()
    return digest


WHOLE = hashlib.sha256(CONTENT).hexdigest()


@pytest.mark.parametrize(
    ("plan", "ranges"),
    [
        ([], [None]),
        ([500, 429, None], [None, None, None]),
        ([PIECE], [None, f"bytes={PIECE}-"]),
        ([PIECE, PIECE], [None, f"bytes={PIECE}-", f"bytes={2 * PIECE}-"]),
        ([PIECE, 416], [None, f"bytes={PIECE}-", None]),
    ],
)
def test_a_download_arrives_whole_whatever_happens_on_the_way(server, plan, ranges):
    server.plan = list(plan)
    assert get(server) == WHOLE and server.asked == ranges


def test_it_follows_redirects_and_asks_a_repository_for_the_address(server):
    assert get(server, "/moved") == WHOLE
    listing = Source(COST.file, server.address + "/files", "", "", "", "", "", is_listing=True)
    assert download_source(listing, "cost").read_bytes() == CONTENT


def test_a_later_command_continues_but_not_with_another_version(server):
    server.plan = [PIECE // 5] * download.TRIES
    with pytest.raises(InputError, match="broke off.*is kept"):
        get(server)
    part = data_folder() / "downloads" / "release.zip.part"
    part_size = part.stat().st_size
    assert part_size == PIECE // 5 * download.TRIES
    server.tag = '"second"'  # the first bytes are of another file by now
    part.write_bytes(b"old" + part.read_bytes()[3:])
    assert get(server) == WHOLE and server.asked[-1] == f"bytes={part_size}-"


@pytest.mark.parametrize(
    ("plan", "busy", "fact"),
    [
        ([404], {}, "answers 404 Not Found"),
        ([500] * 9, {}, "answers 500"),
        ([429], {"Retry-After": "3600"}, "come back later"),
    ],
)
def test_a_refusal_is_one_line_that_says_what_to_do_by_hand(server, plan, busy, fact):
    server.plan, server.headers_of_busy = plan, busy
    with pytest.raises(InputError) as error:
        get(server)
    message = str(error.value)
    facts = (fact, "get release.zip by hand from a page", 'bench data import made "release.zip"')
    assert message.isprintable() and all(word in message for word in facts), message


def test_a_proxy_of_the_environment_is_used(server, monkeypatch):
    monkeypatch.setenv("http_proxy", server.address)
    server.address = "http://touch.example"  # no such host: the proxy alone can answer
    server.plan = [PIECE]
    assert get(server) == WHOLE


def test_nobody_answers(server, monkeypatch):
    server.address = "http://127.0.0.1:9"
    with pytest.raises(InputError, match="cannot be reached: Connection refused"):
        get(server)
    monkeypatch.setenv("http_proxy", server.address)
    server.address = "http://touch.example"
    with pytest.raises(InputError, match="cannot be reached"):
        get(server)
