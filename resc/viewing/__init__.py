"""What is looked at: pictures of episodes and observations, 3-D scenes and their layouts."""
