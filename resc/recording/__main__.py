"""python -m resc.recording --help: commands that show, convert and mend recordings."""

from resc.recording.commands import main

if __name__ == "__main__":
    main()
