"""The verbs of `simnfnd` as a table: what `simnfnd --help` lists, and what runs each.

Imports the standard library alone: `simnfnd --help` must answer at once.
"""

from __future__ import annotations

from typing import NamedTuple


class Verb(NamedTuple):
    """What one word of the command line does, or two.

    group, line: where and how `simnfnd --help` lists it.
    target: "module:function"; the function gets the other words and may return an exit code.
    examples: commands that `simnfnd VERB --help` begins with.
    needs: modules without which it can do nothing, each of an extra (`common.extras`).
    resumes: whether the same command goes on where it was interrupted.
    config: name of the root configuration whose keys its words set, KEY=VALUE; "": it has options.
    """

    group: str
    line: str
    target: str
    examples: tuple[str, ...]
    needs: tuple[str, ...] = ()
    config: str = ""
    resumes: bool = False


MAKE = "Make datasets"
LOOK = "Look at datasets"
PASS_ON = "Merge and convert"
DENOISE = "Denoise"
JUDGE = "Judge"
_COMMANDS = "simnfnd.factory.production.commands"
_SONAR = ("cv2", "scipy")
_NETWORK = ("onnxruntime", "safetensors", *_SONAR)
_TORCH = ("torch", "safetensors", *_SONAR)


VERBS: dict[str, Verb] = {
    "demo": Verb(
        MAKE, "make two small datasets, with the paper's points and by the sonar equation",
        f"{_COMMANDS}.make:demo",
        ("simnfnd demo", "simnfnd demo render=analytic dataset.dir=outputs/first"),
        config="factory", resumes=True,
    ),
    "make": Verb(
        MAKE, "make a dataset from a configuration; -m makes a sweep", f"{_COMMANDS}.make:main",
        (
            "simnfnd make experiment=simnfnd scenes.root=flsea-vi dataset.dir=outputs/flsea",
            "simnfnd make render=analytic scenes=csv_list scenes.file=frames.csv "
            "scenes.intrinsics=[525,525,320,240]",
            "simnfnd make -m noise.background.density=0.1,0.5 resample.rate=0.1,0.3",
            "simnfnd make experiment=demo --cfg job",
        ),
        config="factory", resumes=True,
    ),
    "stream": Verb(
        MAKE, "sail a sonar along a trajectory, into an MCAP file for ROS 2",
        f"{_COMMANDS}.stream:main",
        (
            "simnfnd stream --path circle --count 200 --out outputs/dive sonar=oculus_m750d_hf",
            "simnfnd stream --path examples/platform.csv --out outputs/platform --realtime",
        ),
        needs=("rosbags", *_SONAR),
    ),
    "plan": Verb(
        MAKE, "estimate what `make` would make, and its disk, memory and time",
        f"{_COMMANDS}.plan:main",
        ("simnfnd plan experiment=simnfnd scenes.root=flsea-vi", "simnfnd plan -m seed=1,2,3"),
    ),
    "cache": Verb(
        MAKE, "manage the renders kept on disk: stats, pack, clear",
        f"{_COMMANDS}.cache:main",
        (
            "simnfnd cache stats",
            "simnfnd cache pack experiment=demo --out views.pack",
            "simnfnd make scenes=pack scenes.root=views.pack",
        ),
    ),
    "status": Verb(
        LOOK, "show the progress of a dataset, and which frames failed and why",
        f"{_COMMANDS}.status:main",
        (
            "simnfnd status outputs/demo",
            "simnfnd status outputs/demo --failed",
            "simnfnd status outputs/demo --rerun",
        ),
    ),
    "preview": Verb(
        LOOK, "draw a contact sheet of a dataset or recording",
        "simnfnd.evaluation.viewer.viewer:sheet",
        (
            "simnfnd preview outputs/demo --out outputs/sheet.png --pairs 4",
            "simnfnd preview dive.aris --out outputs/dive.png",
        ),
    ),
    "view": Verb(
        LOOK, "show a dataset or recording in the browser, before and after",
        "simnfnd.evaluation.viewer.viewer:view",
        ("simnfnd view outputs/demo", "simnfnd view dive.aris outputs/denoised/dive.aris"),
    ),
    "lab": Verb(
        LOOK, "choose noise parameters by eye in the browser, beside a real image",
        "simnfnd.evaluation.lab.command:main",
        (
            "simnfnd lab didson_hf dive.avi",
            "simnfnd lab outputs/demo-physical dive.aris",
            "simnfnd lab experiment=aris_raw seabed/seabed-0001/0001 dive.aris",
        ),
        needs=_SONAR,
    ),
    "inspect": Verb(
        LOOK, "summarise a dataset", f"{_COMMANDS}.inspect:main", ("simnfnd inspect outputs/demo",)
    ),
    "validate": Verb(
        LOOK, "check that a dataset is complete and consistent", f"{_COMMANDS}.inspect:check",
        ("simnfnd validate outputs/demo --deep",),
    ),
    "merge": Verb(
        PASS_ON, "merge several datasets into one", f"{_COMMANDS}.merge:main",
        ("simnfnd merge outputs/a outputs/b --out outputs/both",),
    ),
    "export": Verb(
        PASS_ON, "convert a dataset (Hugging Face, COCO, MCAP ...) or a recording (mp4, png, csv)",
        "simnfnd.models.exporting.recordings:main",
        (
            "simnfnd export outputs/demo --to huggingface --out outputs/hub",
            "simnfnd export outputs/labelled --to coco --out outputs/coco",
            "simnfnd export dive.aris --to mp4 --out talk.mp4",
            "simnfnd export outputs/denoised/dive.aris --to csv --out frames.csv",
        ),
    ),
    "train": Verb(
        DENOISE, "train a denoiser on a dataset", "simnfnd.models.training:main",
        ("simnfnd train dataset=outputs/demo model=sonarnet train.steps=200 name=small",),
        needs=_TORCH, config="models", resumes=True,
    ),
    "denoise": Verb(
        DENOISE, "denoise images, videos, datasets, recordings of sonars and bags",
        "simnfnd.models.denoise.options:main",
        (
            "simnfnd denoise outputs/demo --out outputs/denoised",
            "simnfnd denoise dive.aris --out outputs/denoised",
            "simnfnd denoise dive.bag --topic /sonar/image --out outputs/denoised",
            "simnfnd denoise image.png --out outputs/denoised --strength 0.7 --compare",
            "simnfnd denoise lamprey.avi --out outputs/denoised --compare talk.mp4",
            "simnfnd denoise mdd/Images --geometry mdd/fan_geometry.csv --out outputs/mdd",
        ),
        needs=_NETWORK, resumes=True,
    ),
    "detect": Verb(
        DENOISE, "find objects in images, videos, recordings and bags; COCO, a table, overlays",
        "simnfnd.models.detection.command:main",
        (
            "simnfnd detect dive.aris --out outputs/found",
            "simnfnd detect image.png --out outputs/found --overlay",
            "simnfnd detect mdd/Images --out outputs/found --threshold 0.3 --classes Tire,Bottle",
            "simnfnd detect dive.aris --count --out outputs/counted --overlay",
        ),
        needs=_NETWORK, resumes=True,
    ),
    "adapt": Verb(
        DENOISE, "fit weights to your own recordings, without ground truth",
        "simnfnd.models.adapting.command:main",
        (
            "simnfnd adapt dive.aris --out own.safetensors",
            "simnfnd adapt recordings --out own.safetensors --steps 1000",
            "simnfnd denoise dive.aris --weights own.safetensors --out outputs/denoised",
        ),
        needs=_TORCH,
    ),
    "export-weights": Verb(
        DENOISE, "write trained weights in 16 bits with a model card, or as ONNX",
        "simnfnd.models.exporting.export:main",
        (
            "simnfnd export-weights outputs/models/sonarnet/weights.safetensors "
            "--out own.safetensors",
            "simnfnd export-weights simnfnd --to onnx --geometry fan --out fan.onnx",
        ),
        needs=_TORCH,
    ),
    "evaluate": Verb(
        JUDGE, "report on a dataset and on methods that denoise it",
        "simnfnd.evaluation.commands:report",
        (
            "simnfnd evaluate dataset=outputs/demo",
            "simnfnd evaluate dataset=outputs/demo baselines=[all] "
            "models=[outputs/models/sonarnet]",
            "simnfnd evaluate dataset=outputs/demo \"pictures=[{name: mine, dir: outputs/mine}]\"",
        ),
        needs=("pandas", "skimage", *_SONAR), config="evaluation",
    ),
    "evaluate tune": Verb(
        JUDGE, "find the best parameters of the classical filters",
        "simnfnd.evaluation.commands:tune",
        ("simnfnd evaluate tune dataset=outputs/demo baselines=[median,nlm]",),
        needs=("torch", "skimage", *_SONAR), config="evaluation",
    ),
    "evaluate paper": Verb(
        JUDGE, "reproduce the paper's Tables 2 and 3: dataset, trainings and report",
        "simnfnd.evaluation.report.paper:main",
        ("simnfnd evaluate paper --quick",
         "simnfnd evaluate paper --scenes flsea-vi --real mdd"),
        needs=("pandas", "skimage", *_TORCH),
    ),
    "evaluate compare": Verb(
        JUDGE, "test whether one report's row is better than another's",
        "simnfnd.evaluation.report.compare:main",
        ("simnfnd evaluate compare outputs/evaluation/a outputs/evaluation/b "
         "--row-b noisy",),
        needs=("pandas", *_SONAR),
    ),
    "evaluate real": Verb(
        JUDGE, "judge methods on real images and recordings",
        "simnfnd.evaluation.commands:real",
        ("simnfnd evaluate real mdd models=[simnfnd]",),
        needs=("skimage", *_SONAR), config="real",
    ),
    "evaluate targets": Verb(
        JUDGE, "measure what denoising leaves of moving targets inserted into recordings",
        "simnfnd.evaluation.commands:targets",
        ("simnfnd evaluate targets dive.avi", "simnfnd evaluate targets dive.avi frames=[7] "
         "models=[simnfnd,own.safetensors] contrasts=[1,2]"),
        needs=("pandas", "skimage", *_SONAR), config="targets",
    ),
    "evaluate transfer": Verb(
        JUDGE, "measure what a detector that learned from a dataset finds in real images",
        "simnfnd.evaluation.commands:transfer",
        ("simnfnd evaluate transfer outputs/objects tank ignore=[Wall]",
         "simnfnd evaluate transfer outputs/objects tank --quick",
         "simnfnd evaluate transfer tank detector=simnfnd \"class_names={Tyre: Tire}\""),
        needs=("pandas", "pycocotools", *_TORCH), config="transfer",
    ),
    "evaluate counts": Verb(
        JUDGE, "measure counts, tracks and lengths of moving objects in simulated recordings",
        "simnfnd.evaluation.counts.command:main",
        ("simnfnd evaluate counts outputs/fish-didson_hf",),
        needs=("matplotlib", *_SONAR),
    ),
    "evaluate realism": Verb(
        JUDGE, "measure how close datasets come to real images",
        "simnfnd.evaluation.commands:realism",
        ("simnfnd evaluate realism mdd outputs/demo outputs/aris",),
        needs=("skimage", *_SONAR), config="realism",
    ),
    "evaluate fit": Verb(
        JUDGE, "search the noise parameters that come closest to real images",
        "simnfnd.evaluation.commands:fit",
        ("simnfnd evaluate fit mdd name=mine trials=100",
         "simnfnd evaluate fit mdd -- experiment=physical scenes=pack "
         "scenes.root=views.pack"),
        needs=("optuna", "skimage", *_SONAR), config="fit", resumes=True,
    ),
}  # fmt: skip

RENAMED = {"evaluate detect": "evaluate targets"}
"""Names of earlier versions, which still work."""
