"""Objects made of noisy measurements of their surface."""
