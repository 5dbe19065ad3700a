"""The README as a package registry shows it: its links lead to the repository, or are left out where none is known."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?!https?://|#|mailto:)(?P<path>[^)\s]+)\)")


class Readme(MetadataHookInterface):
    """Sets `readme`, with links that work outside of the repository."""

    def update(self, metadata: dict[str, Any]) -> None:
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": outside_of_repository(text, os.environ)}


def outside_of_repository(text: str, environment: Mapping[str, str]) -> str:
    """`text` with relative links made absolute.

    A workflow of GitHub names its repository and commit in `environment`. Where none is named, as in a local build, a
    link keeps its text alone and a picture is left out.
    """
    repository = [environment.get(f"GITHUB_{name}") for name in ("SERVER_URL", "REPOSITORY", "SHA")]

    def absolute(link: re.Match[str]) -> str:
        if not all(repository):
            return "" if link["picture"] else link["text"]
        server, name, commit = repository
        kind = "raw" if link["picture"] else "blob"
        return f"{link['picture']}[{link['text']}]({server}/{name}/{kind}/{commit}/{link['path']})"

    return LINK.sub(absolute, text)
