"""The built-in sweeps, one TOML file each."""
