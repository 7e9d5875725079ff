"""The command line `eos-pin`."""
