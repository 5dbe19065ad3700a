"""The notebooks as pages: their text, their code, and the outputs with which they were saved."""

import base64
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File


def notebook_pages(config: MkDocsConfig) -> Iterator[File]:
    """A page for each notebook, and its pictures."""
    for path in sorted((Path(config.docs_dir) / "notebooks").glob("*.ipynb")):
        parts: list[str] = []
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            text = "".join(cell["source"])
            if cell["cell_type"] == "markdown":
                parts.append(text)
                continue
            parts.append(f"```python\n{text}\n```")
            for output in cell["outputs"]:
                picture = output.get("data", {}).get("image/png")
                if picture is None:
                    parts.append(shown(output))
                    continue
                name = f"{path.stem}-{len(parts)}.png"
                content = base64.b64decode("".join(picture))
                yield File.generated(config, f"notebooks/{name}", content=content)
                parts.append(f"![Output of the code above]({name})")
        parts.append(f"[The notebook itself]({path.name})")
        yield File.generated(config, f"notebooks/{path.stem}.md", content="\n\n".join(parts))


def shown(output: dict[str, Any]) -> str:
    """A table or a text that code put out."""
    data = output.get("data", {})
    if "text/html" in data and "<table" in (html := "".join(data["text/html"])):
        # Markdown would end the table at an empty line; styles of pandas are not those of the site.
        return re.sub(r"<style.*?</style>", "", html, flags=re.DOTALL).replace("\n\n", "\n")
    return f"```text\n{''.join(output.get('text') or data['text/plain']).rstrip()}\n```"
