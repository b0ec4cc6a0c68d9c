"""Pure functions on batched tensors: rotations, integration, geometry."""
