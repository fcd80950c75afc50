"""`inspect` tells what is in a dataset: against what h5py and the metrics of `evaluation` say."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.evaluation.metrics import fidelity as metrics
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.quality import PSNR_CAP_DB, psnr_db, ssim
from simnfnd.factory.production.commands.inspect import report
from tests import small_dataset
from tests.factory.production.export.export_dataset import write
from tests.project_files import ROOT


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("inspect"), labels=True)


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_quality_is_what_evaluation_reports(dtype) -> None:
    noisy, clean, _ = small_dataset.fan_images(64, np.random.default_rng(3))
    if dtype == "uint8":
        noisy, clean = (np.rint(image * 255).astype(np.uint8) for image in (noisy, clean))
    scale = 255.0 if dtype == "uint8" else 1.0
    for ours, theirs in ((psnr_db, metrics.psnr), (ssim, metrics.ssim)):
        wanted = theirs(clean, noisy, data_range=scale)
        assert ours(clean, noisy) == pytest.approx(wanted, abs=1e-6)
    assert psnr_db(clean, clean) == PSNR_CAP_DB
    assert ssim(clean, clean) == pytest.approx(1)
    assert np.isnan(ssim(clean[:8, :8], noisy[:8, :8]))


def test_the_report_says_it_in_words(dataset) -> None:
    lines = list(report(dataset, "little"))
    text = "\n".join(lines)
    assert lines[0].startswith("little: simnfnd/1, made by simnfnd 0.1.0, config hash ")
    assert "9 train, 3 test, in 3 file(s)" in text
    assert "20 x 16 uint8 (0..255), fan" in text
    assert "CC-BY-4.0" in text
    tables = list[np.ndarray]()
    psnr = list[float]()
    for path in sorted(dataset.glob("*/*.h5")):
        with h5py.File(path) as file:
            tables.append(file["meta"]["range_max_m", "noise.background.density"])
            psnr += map(psnr_db, file["clean"][:], file["noisy"][:])
    values, density = (np.concatenate(tables)[name] for name in tables[0].dtype.names)
    table = [line.replace("|", "").split() for line in text.splitlines() if line[:1] == "|"]
    assert ["test", "reef", "reef-test", "3"] in table
    rows = {line[0]: line for line in table}
    figures = (f"{value:.6g}" for value in (values.min(), values.mean(), values.max()))
    assert rows["range_max_m"] == ["range_max_m", *figures, "m", "12"]
    drawn = np.count_nonzero(np.isfinite(density))
    assert drawn < 12, "some were not drawn"
    assert rows["noise.background.density"][-1] == str(drawn)
    assert lines[-2].startswith(f"PSNR, dB: mean {np.mean(psnr):.3f}, std ")


def test_what_is_no_dataset_is_said(tmp_path, dataset) -> None:
    for path, most, words in (
        (tmp_path / "nothing", 1, "no such folder"),
        (tmp_path, 1, "no shards"),
        (dataset, 0, "--pairs"),
    ):
        with pytest.raises(FactoryError, match=words):
            list(report(path, "it", most))


def test_the_preview_of_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = ROOT / "examples" / "didson" / "lamprey.avi"
    out = tmp_path / "sheet.png"
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    assert main(["preview", str(recording), "--out", str(out), "--pairs", "3"]) == 0
    sheet = cv2.imread(str(out))
    assert sheet is not None
    assert sheet.std() > 15
    assert main(["preview", str(recording)]) == 2
    assert "give --out FILE.png" in capsys.readouterr().err
