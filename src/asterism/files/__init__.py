"""The ground under all files: bytes, text, NPZ and TOML read with care, and files that are written whole or not at all."""
