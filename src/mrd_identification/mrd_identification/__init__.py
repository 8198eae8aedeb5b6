"""What the recordings say: fit and gap."""
