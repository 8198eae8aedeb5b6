"""The machine: servo, DAQ, coil supply, interlocks, modes."""
