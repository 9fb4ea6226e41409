"""The controller: bring-up, process image, friction laws, limits, the cycle's compiled step."""
