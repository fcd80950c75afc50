"""How the tests run the commands of the tutorials and how-to pages, and a small recording."""

from __future__ import annotations

from pathlib import Path

from tests.project.readme_steps import Elsewhere, How, NotRun, Run
from tests.project_files import ROOT

# Two procedural frames, of half the size in each direction.
SMALL = (
    "scenes.locations=2",
    "scenes.frames_per_location=1",
    "scenes.width=484",
    "scenes.height=304",
)
_EXAMPLE = Run(instead=(("python examples", "python {root}/examples"),))
_SMALL_MAKE = Run((*SMALL, "render=embree"))

# Page -> command -> how it is run, in the order of reading.
PAGES: dict[str, dict[str, How]] = {
    "docs/how-to/install.md": {
        "make setup": Elsewhere(".ci/run", "make setup"),
        "make test": Elsewhere(".ci/run", "make test"),
        ". .venv/bin/activate": NotRun("the tests run in that environment"),
        'pip install ".[blender,train]"': NotRun("the tests run in an environment that has all"),
    },
    "docs/tutorials/first-dataset.md": {
        # README.md has made it: the command finds it whole.
        "simnfnd demo": Run((*SMALL, "scenes.frames_per_location=2")),
        "simnfnd preview outputs/demo --out outputs/sheet.png --pairs 4": Run(),
        "simnfnd inspect outputs/demo": Run(),
        "simnfnd validate outputs/demo --deep": Run(),
        "simnfnd export outputs/demo --to huggingface --out outputs/hub": Run(),
        "simnfnd make render=analytic scenes.locations=3 scenes.frames_per_location=2 "
        "frames.variants=2 dataset.dir=outputs/larger": Run(SMALL),
        "simnfnd plan render=analytic scenes.locations=100": Elsewhere(
            "tests/factory/render/test_cache_commands.py", '"plan", *words'
        ),
    },
    "docs/tutorials/own-data.md": {
        "simnfnd make scenes=csv_list scenes.root=recording/frames.csv "
        "scenes.intrinsics='[280,280,160,120]' split.test='[quay]' render=analytic "
        "dataset.dir=outputs/own": Run(("scheduler=serial",)),
        "simnfnd inspect outputs/own": Run(),
        "simnfnd status outputs/own --failed": Run(),
    },
    "docs/tutorials/your-own-object.md": {
        "python examples/make_valve.py valve.glb": _EXAMPLE,
        "simnfnd make +scenes/objects=example experiment=physical render=embree scenes.objects=0.5 "
        "scenes.locations=10 frames.variants=2 dataset.layers=[segmentation] "
        "dataset.columns=[boxes] dataset.dir=outputs/valves": Run((*SMALL, "frames.variants=1")),
        "python examples/draw_boxes.py outputs/valves valves.png": _EXAMPLE,
        "simnfnd export outputs/valves --to coco --out outputs/valves-coco": Run(),
        "simnfnd export outputs/valves --to yolo --out outputs/valves-yolo": Run(),
        "simnfnd make scenes=mesh scenes.file=valve.glb "
        "\"scenes.classes=[{class: valve, parts: '*'}]\" render=analytic scenes.paths=2 "
        "scenes.views_per_path=3 dataset.layers=[segmentation] dataset.dir=outputs/world": Run(
            SMALL[2:]
        ),
    },
    "docs/tutorials/noise-sweep.md": {
        "simnfnd make -m scenes.locations=2 scenes.frames_per_location=2 "
        "noise.background.density=0.1,0.5 resample.rate=0.1,0.3": _SMALL_MAKE,
        "simnfnd make scenes.locations=2 scenes.frames_per_location=2 "
        "noise.range_spreading.alpha='{uniform: [0.01, 0.04]}' noise.azimuth.count=3 "
        "dataset.dir=outputs/spread": _SMALL_MAKE,
        "simnfnd make -m experiment=noise_sweep": _SMALL_MAKE,
    },
    "docs/tutorials/train-and-judge.md": {
        "simnfnd train dataset=outputs/demo train.steps=200": Run(
            ("data.patch=64", "data.batch=2", "train.check_every=2"),
            instead=(("train.steps=200", "train.steps=4"),),
        ),
        "simnfnd denoise outputs/demo --out outputs/denoised-own "
        "--weights outputs/models/nafnet/weights.safetensors": Run(),
        "simnfnd denoise outputs/demo --out outputs/denoised": Run(),
        "simnfnd evaluate dataset=outputs/demo": Run(("limit=2", "bootstrap=100")),
        "simnfnd evaluate dataset=outputs/demo baselines=[all] "
        "models=[outputs/models/nafnet,simnfnd]": Run(
            ("limit=2", "bootstrap=100"), instead=(("baselines=[all]", "baselines=[median]"),)
        ),
        "simnfnd evaluate tune dataset=outputs/demo": Run(("tuning.pairs=2", "baselines=[median]")),
        "simnfnd evaluate compare outputs/evaluation/demo-test outputs/evaluation/demo-test "
        "--row-b noisy": Run(),
    },
    "docs/tutorials/denoise-recording.md": {
        # The recording of the sandbox is smaller.  README.md has run the first.
        "simnfnd denoise examples/didson/lamprey.avi --out outputs/lamprey --compare": NotRun(
            "README.md has the same command"
        ),
        "simnfnd denoise examples/didson/lamprey.avi --out outputs/gently --remove speckle "
        "--strength 0.7": Run(),
        "simnfnd denoise examples/didson/lamprey.avi --out outputs/single --frames 1": Run(),
        "simnfnd evaluate real examples/didson/lamprey.avi models=[simnfnd] "
        "baselines=[median,tv]": Run(("workers=1",), instead=(("[median,tv]", "[median]"),)),
    },
    "docs/how-to/sonar.md": {
        "simnfnd make sonar=oculus_m750d_hf sonar.mount.translation_m='[0, 0, 0.5]' "
        "scenes.locations=2 scenes.frames_per_location=2 dataset.dir=outputs/oculus": Run(SMALL),
        "simnfnd make sonar.image.layout=polar sonar.transfer.kind=log scenes.locations=2 "
        "scenes.frames_per_location=2 dataset.dir=outputs/polar": _SMALL_MAKE,
        "simnfnd make --help": Run(),
    },
    "docs/how-to/read.md": {},
    "docs/how-to/judge.md": {
        "simnfnd denoise mdd/Images --out outputs/mdd --compare": Run(needs="{sandbox}/mdd"),
        "simnfnd evaluate real mdd models=[simnfnd]": Run(
            ("workers=1", "baselines=[median]"), needs="{sandbox}/mdd"
        ),
    },
    "docs/how-to/flsea.md": {
        "simnfnd make experiment=simnfnd scenes.root=flsea-vi dataset.dir=outputs/flsea": Run(
            ("frames.limit=1",),
            instead=(("scenes.root=flsea-vi", "scenes.root={shared}/data/flsea-vi"),),
            needs="{shared}/data/flsea-vi",
        ),
    },
}


def small_recording(path: Path) -> None:
    """The recording of examples/didson at a third of its size, as a video without loss."""
    import cv2

    path.parent.mkdir(parents=True)
    video = cv2.VideoCapture(str(ROOT / "examples" / "didson" / "lamprey.avi"))
    out = None
    while (found := video.read())[0]:
        frame = cv2.resize(found[1], None, fx=0.3, fy=0.3, interpolation=cv2.INTER_AREA)
        if out is None:
            size = (frame.shape[1], frame.shape[0])
            out = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 10, size)
        out.write(frame)
    assert out is not None
    out.release()
