"""How long a bit lasts on a bus, in whole nanoseconds."""

from dataclasses import dataclass

import can

NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class Rates:
    """Bit times in ns. data_bit_ns: of the data phase of CAN FD frames; None: a classic bus."""

    bit_ns: int
    data_bit_ns: int | None = None

    @property
    def fd(self) -> bool:
        """Whether frames of CAN FD may be sent."""
        return self.data_bit_ns is not None

    @property
    def bitrate(self) -> float:
        """Nominal bit rate in bit/s."""
        return NS_PER_S / self.bit_ns

    def __str__(self) -> str:
        nominal = f"{self.bitrate:.0f} bit/s"
        return nominal if self.data_bit_ns is None else f"{nominal}, {NS_PER_S / self.data_bit_ns:.0f} bit/s in FD data"


def of_bitrates(bitrate: int, data_bitrate: int | None = None) -> Rates:
    """Return the rates of a bus; ValueError for a bit rate whose bit is no whole number of ns."""
    if data_bitrate is not None and data_bitrate < bitrate:
        raise ValueError(f"data bit rate {data_bitrate} is below the nominal one, {bitrate}: raise it")
    return Rates(bit_time_ns(bitrate), None if data_bitrate is None else bit_time_ns(data_bitrate))


def of_timing(timing: can.BitTiming | can.BitTimingFd) -> Rates:
    """Return the rates that python-can's timing registers give; ValueError as in `of_bitrates`."""
    if isinstance(timing, can.BitTimingFd):
        return of_bitrates(timing.nom_bitrate, timing.data_bitrate)
    return of_bitrates(timing.bitrate)


def bit_time_ns(bitrate: int) -> int:
    """Return the time of a bit in ns; ValueError where that is no whole number."""
    if bitrate <= 0 or NS_PER_S % bitrate:
        raise ValueError(bit_time_refusal(bitrate))
    return NS_PER_S // bitrate


def bit_time_refusal(bitrate: int) -> str:
    """Say why a bit rate is refused."""
    lasts = (
        f"a bit lasts {NS_PER_S / bitrate:.3f} ns, which is no whole number" if bitrate > 0 else "it must be above 0"
    )
    return (
        f"{lasts}; take 1000000, 800000, 500000, 250000 or 125000, and 2000000, 4000000, 5000000 or 8000000 for FD data"
    )
