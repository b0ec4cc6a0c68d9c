"""Many runs: jobs, launchers, and how scripts start."""
