"""Files of a rig for third-party tools: Wireshark, PlotJuggler, Foxglove."""
