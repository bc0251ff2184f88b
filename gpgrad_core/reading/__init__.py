"""Input from outside: text, TOML, JSON, archives and what native libraries decode, all bounded."""
