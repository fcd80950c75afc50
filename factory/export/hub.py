"""A folder of `--to huggingface` as a dataset on the Hugging Face hub, by huggingface_hub.

The hub and the token are those of that library: HF_ENDPOINT and HF_TOKEN, or `hf auth login`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import FactoryError


def check_hub(repo: str) -> None:
    """Ask the hub who we are, before an export that takes hours.

    Raises FactoryError when `repo` is no name of a dataset, the library is not installed, the hub
    cannot be reached or does not know us.
    """
    try:
        from huggingface_hub import HfApi  # an extra
        from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]
    except ImportError as error:
        raise FactoryError("--push needs huggingface_hub: pip install 'simnfnd[export]'") from error
    with _explained(repo):
        validate_repo_id(repo)
        HfApi().whoami()


def push(folder: Path, repo: str, *, private: bool) -> str:
    """Make the dataset `repo` (NAME or OWNER/NAME) unless it is there; returns its address.

    All files of `folder` go into one commit; others of the dataset stay.
    private: only its owner sees a dataset that is made; else as the owner has set on the hub.
    Raises FactoryError when the hub refuses.
    """
    from huggingface_hub import HfApi

    with _explained(repo):
        api = HfApi()
        url = api.create_repo(repo, repo_type="dataset", private=private or None, exist_ok=True)
        api.upload_folder(
            repo_id=url.repo_id,
            repo_type="dataset",
            folder_path=folder,
            commit_message="Exported by SimNFND",
        )
        return str(url)


@contextmanager
def _explained(repo: str) -> Iterator[None]:
    """Any error of the library, which come from three packages, as one line."""
    try:
        yield
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FactoryError(
            f"--push {repo}: {reason}; see `hf auth whoami`, and HF_ENDPOINT for another hub"
        ) from error
