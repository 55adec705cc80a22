"""Every format by its name in the configuration."""

from __future__ import annotations

from typing import Final

from heaved.outputs.telegrams import em, kmb, pashr, pnorsub, prdid, psxn, smc_hex, tss1, xdr
from heaved.outputs.telegrams.spec import Format, Telegram

FORMATS: Final[dict[Telegram, Format]] = {
    Telegram.TSS1: tss1.FORMAT,
    Telegram.EM1000: em.EM1000,
    Telegram.EM3000: em.EM3000,
    Telegram.PASHR: pashr.FORMAT,
    Telegram.PSXN: psxn.FORMAT,
    Telegram.PRDID: prdid.FORMAT,
    Telegram.XDR: xdr.FORMAT,
    Telegram.SMC_HEX: smc_hex.FORMAT,
    Telegram.KMB: kmb.FORMAT,
    Telegram.PNORSUB2: pnorsub.FORMAT_2,
    Telegram.PNORSUB7B: pnorsub.FORMAT_7B,
}
