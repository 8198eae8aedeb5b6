"""The operator's page: see the damper work, stop it, record runs, fit them, explain the gap."""
