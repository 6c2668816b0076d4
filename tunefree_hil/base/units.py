"""Conversion factors. SI inside; other units only in bus, config, cli and figures."""

import math

KPH_PER_MPS = 3.6
G_MPS2 = 9.80665
RAD_PER_DEG = math.pi / 180.0
AIR_DENSITY_KGPM3 = 1.2
