"""The offline page: whatever a folder holds, on one map, in charts and in tables."""
