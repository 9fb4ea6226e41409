"""What other people's tools need to know of a rig: files for Wireshark, PlotJuggler, Foxglove."""
