"""python -m resc.log_command --help: commands that show, convert and mend recordings."""

from resc.log_command import main

if __name__ == "__main__":
    main()
