"""The cycle's compiled step: process image, phases, limits, monitors."""
