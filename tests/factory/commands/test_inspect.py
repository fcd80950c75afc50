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
from simnfnd.factory.commands.inspect import report
from simnfnd.factory.dataset.quality import PSNR_CAP_DB, psnr_db, ssim, summarize
from simnfnd.factory.errors import FactoryError
from tests import small_dataset
from tests.factory.export.export_dataset import write
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


def test_figures_are_those_of_the_files(dataset) -> None:
    found = summarize(dataset)
    shards = sorted(dataset.glob("*/*.h5"), key=lambda path: (path.parent.name != "train", path))
    tables, pairs = [], []
    for path in shards:
        with h5py.File(path) as file:
            tables.append(file["meta"][:])
            pairs += list(zip(file["clean"][:], file["noisy"][:], strict=True))
    table = np.concatenate(tables)
    assert found.stored_bytes == sum(path.stat().st_size for path in shards)
    # noisy, clean, shadow, segmentation: a byte a pixel; instance two, range four.
    assert found.image_bytes == 12 * 20 * 16 * (4 + 2 + 4)
    assert list(found.splits) == ["train"] * 9 + ["test"] * 3
    np.testing.assert_array_equal(found.table["range_max_m"], table["range_max_m"])
    assert found.numbers("noise.background.density").size < 12  # some were not drawn
    assert found.psnr_db == pytest.approx([psnr_db(*pair) for pair in pairs])


def test_the_report_says_it_in_words(dataset) -> None:
    text = "\n".join(report(summarize(dataset), "little"))
    lines = text.splitlines()
    assert lines[0].startswith("little: simnfnd/1, made by simnfnd 0.1.0, config hash ")
    assert "9 train, 3 test, in 3 file(s)" in text
    assert "20 x 16 uint8 (0..255), fan" in text
    assert "gzip 1, fletcher32" in text
    assert "CC-BY-4.0" in text
    scene = next(line for line in lines if line.startswith("| test ") and "reef" in line)
    assert scene.replace("|", "").split() == ["test", "reef", "reef-test", "3"]
    values = summarize(dataset).numbers("range_max_m")
    row = next(line for line in lines if line.startswith("| range_max_m")).replace("|", "").split()
    figures = (f"{value:.6g}" for value in (values.min(), values.mean(), values.max()))
    assert row == ["range_max_m", *figures, "m", "12"]
    assert lines[-2].startswith(f"PSNR, dB: mean {np.mean(summarize(dataset).psnr_db):.3f}, std ")


def test_the_index_can_be_given(dataset) -> None:
    (dataset / "index.h5").touch()  # only its place matters
    try:
        assert summarize(dataset / "index.h5").pairs.splits == {"train": 9, "test": 3}
    finally:
        (dataset / "index.h5").unlink()


def test_what_is_no_dataset_is_said(tmp_path, dataset) -> None:
    with pytest.raises(FactoryError, match="no such folder"):
        summarize(tmp_path / "nothing")
    with pytest.raises(FactoryError, match="no shards"):
        summarize(tmp_path)
    with pytest.raises(FactoryError, match="--pairs"):
        summarize(dataset, pairs=0)


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
