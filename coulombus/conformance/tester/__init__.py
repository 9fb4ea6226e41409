"""What the cases are made with: the link, clients, probes, stimuli, verdicts."""
