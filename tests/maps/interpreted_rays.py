"""The kernels for GPUs on the CPU: python interpreted_rays.py given.pt found.pt.

Triton reads whether it interprets when it is imported, so this takes a process of its own.
"""

import os
import sys

os.environ["TRITON_INTERPRET"] = "1"

import torch

from resc.maps import gpu_kernels
from resc.maps.ray_casting import toward

if __name__ == "__main__":
    given = torch.load(sys.argv[1])
    offset, radius = given["guided"]
    maps, limits = given["maps"], given["limits"]
    found = {
        "guided": gpu_kernels.guided(*maps, offset, toward(offset), radius, 0.1, limits),
        "cast": [gpu_kernels.cast(*maps, *fan, 0.1, limits) for fan in given["cast"]],
    }
    torch.save(found, sys.argv[2])
