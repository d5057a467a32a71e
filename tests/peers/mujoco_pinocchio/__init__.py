"""The same discrete loop as the project's, on MuJoCo's Python package."""
