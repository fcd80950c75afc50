"""Learning from another network's output beside the clean pictures."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from ..data.pairs import Batch
from ..losses import Loss
from ..networks.network import known_extras
from ..networks.weights import channels_last, load_weights


class Teacher:
    """Trained weights whose pictures a network learns to make (Hinton et al. 2015, for pictures).

    What a small network cannot do shows as noise in the gradients when it learns from clean
    pictures alone; the pictures of a larger one that learned from the same are nearer to what it
    can do.  Heads are taught as well: the shadow that the teacher sees.
    """

    def __init__(self, weights: Path, share: float) -> None:
        """weights: a file that training wrote.  share: of its pictures in the loss, 0 to 1.

        Raises FactoryError for a file that holds no weights.
        """
        network = load_weights(weights).network
        self.network = channels_last(network).requires_grad_(False).eval()
        self.share = share

    @property
    def extras(self) -> tuple[str, ...]:
        """Optional inputs that the teacher uses."""
        return self.network.extras

    @torch.no_grad()
    def picture(self, batch: Batch) -> Tensor:
        """(N, C, H, W), what the teacher makes of noisy pictures, with the whole change."""
        noisy = batch["noisy"]
        self.network.to(noisy.device)
        known = known_extras(self.network, batch)
        if self.network.has_heads:
            return self.network.with_heads(noisy, **known).image
        found: Tensor = self.network(noisy, **known)
        return found

    def loss(self, loss: Loss, prediction: Tensor, batch: Batch) -> Tensor:
        """Scalar tensor: the loss against clean pictures and teacher's, weighed by `share`.

        prediction: (N, C, H, W).  batch: as losses get it, with the heads' output.  Where its clean
        pictures are NaN, as those of recordings, the teacher's are all that is known.
        """
        noisy = batch["noisy"]
        self.network.to(noisy.device)
        known = known_extras(self.network, batch)
        # How much of a change is right is measured against the truth, never against the teacher.
        lesson = {name: batch[name] for name in batch if name not in ("weight", "shadow")}
        with torch.no_grad():
            if self.network.has_heads:
                output = self.network.with_heads(noisy, **known)
                image = output.image
                lesson["shadow"] = torch.sigmoid(output.shadow_logits.float())
            else:
                image = self.network(noisy, **known)
        image = image.to(prediction.dtype)
        taught = loss(prediction, image, lesson)
        clean = batch["clean"]
        unknown = clean.isnan()
        if unknown.any():
            clean = torch.where(unknown, image, clean)
            if "shadow" in lesson:
                seen = torch.where(unknown, lesson["shadow"], batch["shadow"])
                batch = {**batch, "shadow": seen}
        return self.share * taught + (1 - self.share) * loss(prediction, clean, batch)
