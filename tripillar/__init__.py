"""TriPillar: from a sensor's design to forces with error bars."""
