"""What MkDocs calls: the pages that are made from the code join those that are written."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # MkDocs runs this file by its path


def on_files(files: Files, config: Any) -> Files:
    """Add what is made from the code."""
    from docs.making.pages import reference

    for path, text in reference().items():
        files.append(File.generated(config, path, content=text))
    return files
