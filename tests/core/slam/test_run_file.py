"""Records and rows that an earlier version wrote are read, and written again byte for byte."""

import json
import math
import zlib
from base64 import b85decode
from dataclasses import replace
from pathlib import Path

import numpy as np

from gpgrad_core.io.records.closures import Decision, read_row, rounded, row_of
from gpgrad_core.se2 import SE2
from gpgrad_core.slam.run_file import HEAD, MAGIC, RunWriter, read_run
from gpgrad_core.types import Agreement, Context, ImageVerdict

# Three submaps of four points. Of the last moment's pairs one has every value and one has none.
RECORD = (
    "c-rk(Piz!b7@wwUh;oqFUX+kM7*9yLMT;Sk*~Eh$^dR9z%<ww%?d;Q;_lEc0v@F^Li$yt@6bdn#DF3?C-FCZG4$7@7"
    "#e+@=1c>oOP!ofY6bK$Xc<{~4o7r}uDUf0~_%1v1dvCt?zTfxz-uJET*$i1Z=966hN#3bx-<RH5w|`ueJ*aXJ0u!4D"
    "cD$(4vmw8sXPh7xf_^Ac27!kda{0&!7kT^Z4iH<E3~nL^YRDJVMFN{OLNNz}3#)}qC74SsaK<CFo&YwZgQ65_YACdb"
    "OhH+w-%QX+j%|XR#TF-Bw9D`)CW0>j8F1?O0#g#|U!8jU`pCLdmA2zmi-3eL7w(;oOh}^!lQ<3aiyPw+!|y>kF@Co5"
    "YSjV((TRp*Dk|Ke9yB6?Fc2ZXCN_ln-^pRCauc&8NgS>yv&xIW^@Wd|xjF+Ia}iIHk!egE49tj(`3pP=1jESTXP^0G"
    "vLsI;O2C1ymH|S{EP?gJI0vw_3Dcom`ttFVi;0n#;#w_w;ie2%SXh;8{!QeQg*nGAb`Zm&+}i5fXwC&hmRc~Ocnb9^"
    "%9ZFmj86z)3}F&r7ump1&|<M7S@BBy8`PpM2v#;MhKnN95AFW-^+wnG^$d^ArDzGTT@vZqj}mmc1d<bCx4}~>99!7Y"
    "|JH?DwSTGtJ0d|uvh1W{#!$B7Ii-jh#5px_9DrnEE{Xi4Pb94gR(M|dDg`wF?88Pxf()#|clsz|wr@`&P7@IeTS&ly"
    "=uIbaQc(>HU5TwJOiTu@6b*7tKi8pY$B%|Te;TJ=!2N!iQ^&D2-Xlklh;MJerK=9iO_);FF5#WQ0CIfbXL__nV~?&L"
    "^w#^HE$TPIw#;yWnBayKo^*%9+_Xn!s-*$>EX%?Bdq~w?i>(RfLvxDwt_&LWJgLxX^fHJYOXjwGl7}Es^t7r2MPX21"
    "Gy~}xWxUzCHkv`4QoQ-QG(7Xi4wl?bflDLm6jL!x6%S#?M{B%9nQ&xQH3OO21gz1_{%GJi$drt|qCL>KsZW`7KxPCY"
    "k(D=6bh)pVo3FTZ0IZD2NDa3en-AYj4f&N;!>Hb_hSTk8NK^gZL@;};F~4uVFVt@|ySEN)zxYtpU`mR*FPu5Mlp6B)"
    "qXzFm)sXyN(U)7<Ckbg>o7FFFAKKd8ys=nCqbsGN6;`8uzNN<DH%HgrO^usYT8*m;%d7F`{iyNW<ou=E-Gfq%9ovo!"
    "%^!OxYW(hTO&j_0$oi$!xG7QN!OL1#Wv36U9D`L^C{RD*5DT`7OcOi-)?B~<aY|-;bE=5vw!E6lug}F*JonOu-j^d_"
    "<Aj<Wu9(y(qI0|-3x1~KXkA8+Imk0)WkO*=5iKRh7&s_thg3pWRAaCv?Mi4gJr?SJDf(v9%ujoV=|ycps9#l$&Tc~%"
    "eAzLEvrW~fwIn_^mKE%*NM{imYe8uXuwd>k0e!abx9e+Pd$F=Rsn%a-p2)^7YujqbW)K%wY5#-zs{9Loma}#s)PMXu"
    "8eddl09z29FzeXD+4F54pS-gh3JZ@Z!jfj^P|c*Ih?xskJ>Q$7#awSsu82j~YMBm1z%Fq(EIggsU6Xo}ZkZ-pM<b1#"
    "i!IB6gRP4<U2<7_YAFHrWCA*^1T-VN5kf`oUEi`{b8c6gV6;Rq+G4$=L@&}y3M##%udS%3$c)@C>UX0A<B^tYKC!@*"
    "EX&92Dn2k4E55VULnc@AfqQaq?$LBFyC@DEj8CtMby8uf|8<4Ax4T}`2D@)xnx8zUADbUKvaO@7GX3(XRi>4$a7unZ"
    "$qIL?{6ojS`1+oR{`fjzExf<)>>2)#=%XCbe*v{!^Xd"
)
ROWS = (
    '{"query": "0007", "database": "0001", "num_inliers": 2, "score": 4.25, "dissimilarity": 0.75, '
    '"overlap_area": 31.0, "accepted": true, "reason": "2 inliers >= 1, score 4.25 >= 3", '
    '"T_database_query": {"x": 1.25, "y": -0.5, "yaw": 3.0}, "z_offset": -0.125, "covariance": '
    "[[0.01, 0.002, 0.0], [0.002, 0.02, 0.0], [0.0, 0.0, 0.0001]], "
    '"overlap_middle": [0.5, 0.25], "z_std": 0.0625, "scale": 0.3, "agreement": '
    '{"difference": 0.007, "possible": 0.005, "relief": 0.2}, "decision": {"accepted": true, '
    '"note": "seen"}, "images": {"verdict": "confirmed", "reason": "12 of 20 fit", '
    '"num_associations": 20, "num_inliers": 12}, "mean_dissimilarity": 2.5, "context": '
    '{"own_score": 4.0, "score": 4.25, "misfit": 1.5, "support": 0.25, "places": 1}}',
    '{"query": "0007", "database": "0000", "num_inliers": 0, "score": 0.0, "dissimilarity": null, '
    '"overlap_area": 0.0, "accepted": false, "reason": "cannot judge: x", "T_database_query": '
    'null, "z_offset": null, "covariance": null, "z_std": null, "scale": null, "agreement": null}',
)
"""The same pairs as ``closures.json`` has them."""


def behind_settings(content: bytes) -> bytes:
    """What follows the first entry, which has the version and the defaults of the writer."""
    size, _ = HEAD.unpack_from(content, len(MAGIC))
    return content[len(MAGIC) + HEAD.size + size :]


def test_a_record_of_an_earlier_version_is_read_and_written_again(tmp_path: Path) -> None:
    before, again = tmp_path / "before.gpgrad", tmp_path / "again.gpgrad"
    before.write_bytes(zlib.decompress(b85decode("".join(RECORD))))
    run = read_run(before)
    assert not run.notes
    assert run.settled
    last = run.moments[-1]
    known, unknown = last.closures
    found = known.registration
    assert known.pair == ("0007", "0001")
    assert found.T_database_query == SE2(1.25, -0.5, 3.0)
    np.testing.assert_array_equal(found.inliers, [True, False, True])
    np.testing.assert_array_equal(np.diag(found.covariance), [0.01, 0.02, 1e-4])
    assert (found.agreement, known.context) == (
        Agreement(0.007, 0.005, 0.2),
        Context(4.0, 4.25, 1.5, 0.25, 1),
    )
    assert known.images == ImageVerdict("confirmed", "12 of 20 fit", 20, 12)
    assert (found.evidence, found.overlap_middle) == ((1.5, -0.25, 3.0), (0.5, 0.25))
    assert unknown.undecided
    assert unknown.registration.nothing_trusted
    assert unknown.registration.dissimilarity == math.inf
    unsettled = replace(last, rejected=(("0007", "0001"),), moved=0.5)
    with RunWriter(again, run.settings) as writer:
        for submap, moment in zip(run.submaps, (*run.moments[:-1], unsettled), strict=True):
            writer.keep(submap, starts_traverse=submap.id in run.starts)
            writer.add(moment)
        writer.settle(last)
    assert behind_settings(again.read_bytes()) == behind_settings(before.read_bytes())


def test_a_row_of_an_earlier_version_is_read_and_written_again() -> None:
    for text, decision in zip(ROWS, (Decision(True, "seen"), None), strict=True):
        closure = read_row(json.loads(text), "rows")
        assert json.dumps(row_of(closure, decision)) == text
        assert json.dumps(row_of(rounded(closure), decision)) == text
