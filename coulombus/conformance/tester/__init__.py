"""Building blocks of the cases: link, clients, probes, stimuli, verdicts."""
