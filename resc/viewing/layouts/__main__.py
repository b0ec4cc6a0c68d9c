"""Rewrites the layouts for the default training: python -m resc.viewing.layouts."""

from pathlib import Path

from resc.viewing.layouts import DEFAULT, foxglove, lichtblick

for name, layout in (("foxglove", foxglove), ("lichtblick", lichtblick)):
    path = Path(__file__).with_name(f"{name}.json")
    path.write_text(layout(*DEFAULT) + "\n")
    print(path)
