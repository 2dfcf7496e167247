"""Electrode detection in RGB-D images. Not yet available: give docking the electrodes' pose, or any node that serves
`detect_electrodes`."""
