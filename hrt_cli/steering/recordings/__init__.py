"""Folders of recorded drives, in several formats, as frames with labels."""
