"""The folders of the Marine Debris Dataset (ARIS Explorer 3000): Images/ and Masks/.

Images/NAME.png is the noisy picture, uint8 gray, a fan with far range on top and 0 outside of it;
Masks/NAME.png is the class of every pixel, uint8.  The classes of the procedural scenes 0 to 11 are
MDD's own (0 Background, 1 Bottle ... 11 Wall); those that MDD has not (Boulder, Pipe, ...) become
0.  Two folders MDD has not stand beside: Clean/ (the ideal picture) and Shadows/ (255 in shadow).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..dataset.format.schema import stored_image
from ..dataset.read.source import Source
from ..errors import FactoryError
from ..labels import CLASSES
from .pictures import png, write_notes

# Background and the eleven objects of MDD, in its order.
MDD_CLASSES = CLASSES[:12]


def write(source: Source, folder: Path) -> str:
    """Fill `folder`; SPLIT.txt lists the names of each split.

    float32 pictures are rounded to uint8.  Raises FactoryError for a dataset without labels or
    with polar pictures.
    """
    if "segmentation" not in source.layers:
        raise FactoryError(
            f"--to mdd: {source.directory} has no labels (/segmentation); make it from procedural "
            "scenes with dataset.layers=[segmentation], or export with --to png"
        )
    if source.layout != "fan":
        raise FactoryError(
            f"--to mdd: {source.directory} holds polar pictures, MDD's are fans; make it with "
            "sonar.image.layout=fan, or export with --to png"
        )
    for name in ("Images", "Masks", "Clean", "Shadows"):
        (folder / name).mkdir()
    for split in source.splits:
        names = []
        for sample in source.samples(split):
            labels = sample.images["segmentation"]
            masks = np.where(labels < len(MDD_CLASSES), labels, 0).astype(np.uint8)
            for name, image in (
                ("Images", stored_image(sample.images["noisy"], "uint8")),
                ("Masks", masks),
                ("Clean", stored_image(sample.images["clean"], "uint8")),
                ("Shadows", sample.images["shadow"]),
            ):
                (folder / name / f"{sample.key}.png").write_bytes(png(image))
            names.append(sample.key)
        (folder / f"{split}.txt").write_text("".join(f"{name}\n" for name in names))
    (folder / "classes.txt").write_text("".join(f"{name}\n" for name in MDD_CLASSES))
    write_notes(source, folder, _NOTES)
    return f"{sum(source.splits.values())} pictures with masks"


_NOTES = """\
As in the Marine Debris Dataset, `Images/NAME.png` is a sonar picture (the noisy one) and
`Masks/NAME.png` holds the class of each of its pixels; `classes.txt` names class 0, 1, 2, ...
(MDD's own; objects that MDD does not know are 0, Background). `Clean/NAME.png` is the ideal picture
of the same scene and `Shadows/NAME.png` is 255 in acoustic shadow. `train.txt` and `test.txt` list
the names.
"""
