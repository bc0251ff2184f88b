"""How laws are checked here: no law about seconds, for a busy machine is not a wrong program."""

from hypothesis import settings

settings.register_profile("core", deadline=None, print_blob=True)
settings.load_profile("core")
