"""The version: read by the build, by ``gpgrad --version`` and by the files that are written."""

VERSION = "0.1.0"
