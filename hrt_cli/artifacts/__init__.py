"""The contracts between stages: strict JSON and NPZ, atomic publish, provenance, caching."""
