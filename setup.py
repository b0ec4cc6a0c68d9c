"""Copies what RESC reads beside its code into a wheel: see resc/places.py."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

SHIPPED = (
    "conf",
    "policies",
    "docs/results/references.json",
    "docs/results/default_training.json",
    "train.py",
    "evaluate.py",
)
"""Kept below resc/shipped as they lie in the repository."""


class WithFiles(build_py):
    """`build_py`, and the files; an editable installation reads those of the repository."""

    def run(self) -> None:
        """Builds the package."""
        super().run()
        if self.editable_mode:
            return
        home = Path(self.build_lib) / "resc" / "shipped"
        shutil.rmtree(home, ignore_errors=True)
        for name in SHIPPED:
            source, target = Path(name), home / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)


setup(cmdclass={"build_py": WithFiles})
