"""`simnfnd view`: what the page is given, to whom, and the page itself in Chromium."""

from __future__ import annotations

import json
import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from http.client import HTTPConnection
from pathlib import Path
from socket import create_connection
from typing import Any
from urllib.error import HTTPError
from urllib.parse import quote
from urllib.request import urlopen

import cv2
import h5py
import numpy as np
import pytest

from simnfnd.evaluation.viewer import page_server
from simnfnd.evaluation.viewer import viewer as server
from simnfnd.evaluation.viewer.viewer import Shown, Viewer, open_shown
from simnfnd.factory.common.errors import FactoryError
from tests.evaluation.browser import CHROMIUM, kept_by_page
from tests.factory.production.export.export_dataset import SHAPE, write
from tests.models.recordings.recording_files import pings, write_aris
from tests.recorded_dataset import FRAMES, recorded_pair, write_recordings

# Pressed one after the other: to the last, two back by ten (to the first), two on, swap.
_KEYS = """
<script>
  const press = (key, shiftKey) => document.dispatchEvent(
    new KeyboardEvent("keydown", {key, shiftKey, bubbles: true}));
  const wait = setInterval(() => {
    if (document.body.dataset.shown !== "0") return;
    clearInterval(wait);
    for (const key of ["End", "Home", "ArrowRight", "ArrowRight", "ArrowLeft", " "]) press(key);
    press("ArrowRight", true);
    press("ArrowLeft");
  }, 50);
</script>
"""

# Plays, and sends what is shown when the last frame has stopped it.
_PLAY = """
<script>
  const button = document.getElementById("play");
  const kept = {};
  const when = (holds, then) => setTimeout(() => (holds() ? then() : when(holds, then)), 20);
  when(() => document.body.dataset.shown === "0", () => {
    document.dispatchEvent(new KeyboardEvent("keydown", {key: "p", bubbles: true}));
    kept.began = button.textContent;
    when(() => button.textContent !== kept.began, () => {
      kept.shown = document.body.dataset.shown;
      kept.pressed = button.getAttribute("aria-pressed");
      kept.label = button.textContent;
      fetch(`kept?${encodeURIComponent(JSON.stringify(kept))}`);
    });
  });
</script>
"""


@contextmanager
def served(shown: Shown) -> Iterator[str]:
    with Viewer(shown) as viewer:
        threading.Thread(target=viewer.serve_forever, daemon=True).start()
        try:
            yield viewer.url
        finally:
            viewer.shutdown()


def fetched(url: str) -> bytes:
    with urlopen(url, timeout=90) as answer:
        content: bytes = answer.read()
        return content


def code(url: str) -> int:
    with pytest.raises(HTTPError) as caught:
        fetched(url)
    return caught.value.code


def image(url: str, number: int, layer: int) -> np.ndarray:
    content = np.frombuffer(fetched(f"{url}image/{number}/{layer}.png"), np.uint8)
    found = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("viewed") / "little", labels=True)


def test_images_and_parameters_of_a_dataset(dataset: Path) -> None:
    with served(open_shown(dataset)) as url:
        about = json.loads(fetched(f"{url}about.json"))
        assert (about["title"], about["count"]) == ("little", 12)
        names = about["layers"]
        assert names[:3] == ["noisy", "clean", "shadow"]
        assert {"range", "segmentation", "instance"} <= set(names)
        with h5py.File(dataset / "test/shard-00000.h5") as file:
            stored: dict[str, Any] = {name: file[name][1] for name in names}
            row = file["meta"][1]
        order = json.loads(fetched(f"{url}facts/0.json"))["scene"]
        number = 1 if order == "reef-test" else 10
        np.testing.assert_array_equal(image(url, number, 0), stored["noisy"])
        np.testing.assert_array_equal(image(url, number, 2), stored["shadow"] * 255)
        colours = image(url, number, names.index("segmentation"))
        assert colours.shape == (*SHAPE, 3)
        assert (colours.any(axis=-1) == (stored["segmentation"] > 0)).all()
        facts = json.loads(fetched(f"{url}facts/{number}.json"))
        assert facts["frame"] == row["frame"].decode()
        assert facts["range_max_m"] == row["range_max_m"]
        drawn = float(row["noise.background.density"])
        assert facts["noise.background.density"] == (drawn if np.isfinite(drawn) else None)


def test_only_what_is_shown_and_only_to_this_machine(dataset: Path) -> None:
    with served(open_shown(dataset)) as url:
        assert url.startswith("http://127.0.0.1:")
        port = url.split(":")[2].split("/")[0]
        assert fetched(url).startswith(b"<!doctype html>")
        for path in ("image/12/0.png", "image/0/99.png", "facts/12.json", "../pyproject.toml"):
            assert code(url + path) == 404, path
        # Another user of the machine knows the port and not the token.
        for path in ("", "about.json", "image/0/0.png", f"{'x' * 32}/about.json", "\u00fc/"):
            assert code(f"http://127.0.0.1:{port}/{quote(path)}") == 403, path
    with Viewer(open_shown(dataset)) as one, Viewer(open_shown(dataset)) as other:
        assert one.token != other.token


def connection(url: str) -> HTTPConnection:
    return HTTPConnection("127.0.0.1", int(url.split(":")[2].split("/")[0]), timeout=30)


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1:{port}", 200), ("localhost:{port}", 200), ("127.0.0.1", 403),
     ("attacker.example:{port}", 403), ("", 403), (None, 403)],
)  # fmt: skip
def test_a_name_bound_to_this_address_gets_nothing(
    dataset: Path, host: str | None, expected: int
) -> None:
    """A page elsewhere cannot make the browser read what is shown (DNS rebinding)."""
    with served(open_shown(dataset)) as url, closing(connection(url)) as asked:
        asked.putrequest("GET", f"/{url.split('/')[3]}/about.json", skip_host=True)
        if host is not None:
            asked.putheader("Host", host.format(port=asked.port))
        asked.endheaders()
        assert asked.getresponse().status == expected


def test_half_open_connections_end_and_block_no_other(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_server._Handler, "timeout", 0.5)
    with served(open_shown(dataset)) as url, ExitStack() as stack:
        address = ("127.0.0.1", connection(url).port)
        silent = [stack.enter_context(create_connection(address, 30)) for _ in range(40)]
        for one in silent[::2]:
            one.sendall(b"GET / HT")
        assert json.loads(fetched(f"{url}about.json"))["count"] == 12
        assert {one.recv(1) for one in silent} == {b""}, "the server closes them"


def test_many_requests_at_once_are_answered(dataset: Path) -> None:
    with served(open_shown(dataset)) as url, ThreadPoolExecutor(120) as pool:
        paths = [f"image/{number % 12}/{number % 2}.png" for number in range(120)]
        answers = list(pool.map(fetched, (url + path for path in paths)))
        for path, answer in zip(paths, answers, strict=True):
            assert answer == fetched(url + path)


def test_a_recording_before_and_after(tmp_path: Path) -> None:
    given = pings(3, 40, 48)
    before = write_aris(tmp_path / "before.aris", given)
    after = write_aris(tmp_path / "after.aris", given // np.uint8(2))
    with served(open_shown(before, after)) as url:
        about = json.loads(fetched(f"{url}about.json"))
        assert about.pop("rate_hz") == pytest.approx(10, abs=0.01)
        assert about == {"title": "before.aris", "count": 3, "layers": ["before", "after"]}
        fans = [image(url, 2, layer).astype(int) for layer in (0, 1)]
        assert fans[0].shape == fans[1].shape
        assert np.abs(fans[1] - fans[0] / 2).max() <= 3  # shown in one window of grey values
        facts = json.loads(fetched(f"{url}facts/2.json"))
        assert (facts["samples"], facts["name"]) == ("40x48", "ARIS 1800")


def test_what_cannot_be_shown_costs_a_line(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="no such file"):
        open_shown(tmp_path / "nowhere")
    with pytest.raises(FactoryError, match="a dataset"):
        open_shown(dataset, dataset)
    (tmp_path / "a.png").write_bytes(b"no image")
    with served(open_shown(tmp_path)) as url:
        assert code(f"{url}image/0/0.png") == 500
        with pytest.raises(FactoryError, match=r"--port \d+"):
            Viewer(open_shown(tmp_path), int(url.split(":")[2].split("/")[0]))


def test_a_recording_of_a_dataset_is_shown_alone_at_its_rate(tmp_path: Path) -> None:
    folder = write_recordings(tmp_path / "dataset", shard_size=6)
    with served(open_shown(folder / "sea/1")) as url:
        about = json.loads(fetched(f"{url}about.json"))
        assert (about["title"], about["count"]) == ("dataset sea/1", FRAMES)
        assert about["rate_hz"] == 4
        for number in (0, FRAMES - 1):
            expected = recorded_pair("1", number).noisy
            np.testing.assert_array_equal(image(url, number, 0), expected)
            assert json.loads(fetched(f"{url}facts/{number}.json"))["frame"] == f"{number:04d}"
    with pytest.raises(FactoryError, match="sea/0"):
        open_shown(folder / "sea/9")


def page_after(shown: Shown, script: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The page in Chromium after a script that is appended to it."""
    page = folder / "page.html"
    page.write_text(server._PAGE.read_text(encoding="utf-8") + script, encoding="utf-8")
    monkeypatch.setattr(server, "_PAGE", page)
    with served(shown) as url:
        command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
        options = ["--virtual-time-budget=60000", f"--user-data-dir={folder / 'profile'}"]
        done = subprocess.run(
            [*command, *options, url], capture_output=True, text=True, timeout=120
        )
    return done.stdout


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_the_page_plays_a_recording_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_recordings(tmp_path / "dataset")
    page = tmp_path / "page.html"
    page.write_text(server._PAGE.read_text(encoding="utf-8") + _PLAY, encoding="utf-8")
    monkeypatch.setattr(server, "_PAGE", page)
    with Viewer(open_shown(folder / "sea/0")) as viewer:
        kept = kept_by_page(viewer, tmp_path, monkeypatch)
    assert kept == {
        "began": "pause",
        "shown": str(FRAMES - 1),
        "pressed": "false",
        "label": "play",
    }


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_the_page_steps_by_keyboard(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = page_after(open_shown(dataset), _KEYS, tmp_path, monkeypatch)
    # First, last, first, two on, one back, ten on, one back: number 10 of 0 to 11.
    for part in ('data-shown="10"', ">11 of 12<", "inset(0px 0px 0px 100%)",
                 'src="image/10/0.png"', "<td>range_max_m</td>"):  # fmt: skip
        assert part in found
    assert "noise.range_spreading.mode" not in found  # not drawn, so not said
