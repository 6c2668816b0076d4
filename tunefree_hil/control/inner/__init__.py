"""Inner-loop controllers: the file name is the public name, each exports CONTROLLER (control/contract.py)."""
