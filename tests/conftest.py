"""What every test shares.

A conftest here also puts this folder on the path, so that tests can import their helpers (`raster_files`).
"""

from hypothesis import settings

# A slow or busy machine is no failure: no test is judged by the clock.
settings.register_profile("hrt", deadline=None)
settings.load_profile("hrt")
