"""The fault campaign: what the whole bench does when something breaks, as a table that is measured (`make faults`)."""
