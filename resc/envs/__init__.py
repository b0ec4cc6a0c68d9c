"""The world, the compiled step and the TorchRL environment."""
