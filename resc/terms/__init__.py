"""What a study swaps: one term a file, one YAML a term."""
