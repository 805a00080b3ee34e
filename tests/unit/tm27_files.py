"""IES TM-27 files for tests."""


def tm27(quantity: str) -> str:
    """Return the text of a file of a flat spectrum of 0.5 that states a quantity."""
    data = "".join(f'<SpectralData wavelength="{nm}">0.5</SpectralData>' for nm in range(380, 731, 10))
    stated = f"<SpectralQuantity>{quantity}</SpectralQuantity>"
    return (
        '<IESTM2714 xmlns="http://www.ies.org/iestm2714" version="1.0"><SpectralDistribution>'
        f"{stated}{data}</SpectralDistribution></IESTM2714>"
    )
