"""How hard training is at each moment: numbers in [0, 1] that others read."""
