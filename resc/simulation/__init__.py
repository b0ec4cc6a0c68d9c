"""From command to state: rate loop, allocation, rotors, rigid body; one model a file."""
