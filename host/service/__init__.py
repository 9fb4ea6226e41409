"""The host as a system service: systemd units and their configuration files."""
