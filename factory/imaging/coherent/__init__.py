"""The physical image formation: scatterers of the world, their complex field, the device's beams.

`acoustics.formation=field` chooses it; the paper's points are `simnfnd.factory.pairs`.
"""
