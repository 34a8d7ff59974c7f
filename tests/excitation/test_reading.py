"""Records are read as they stand in the file, and a file that cannot be right is refused with the place and the reason.

All numbers in the files are invented.
"""

import numpy as np
import pytest

from stickslip_jax._excitation.reading import read_acceleration_csv, read_at2, read_csv, read_recorded_csv
from stickslip_jax._excitation.recorded import GroundAcceleration, Recorded

G = 9.80665
TIMES, VALUES = [0.0, 0.5, 1.25], [0.1, -2.0, 30.0]


@pytest.fixture
def file(tmp_path):
    """Writes a file and tells its path."""

    def write(text, name="record.csv", encoding="utf-8"):
        path = tmp_path / name
        path.write_bytes(text.encode(encoding))
        return path

    return write


def refuses(read, path, pattern, error=ValueError):
    """`read` refuses the file with one sentence that names it and holds `pattern`."""
    with pytest.raises(error, match=pattern) as caught:
        read(path)
    sentence = str(caught.value)
    assert sentence.startswith("Argument "), sentence
    assert sentence.endswith("."), sentence
    assert "\n" not in sentence
    assert " must " in sentence
    assert ", but " in sentence
    assert repr(str(path)) in sentence


class TestTables:
    @pytest.mark.parametrize(
        ("text", "options"),
        [
            ("0,0.1\n0.5,-2\n1.25,3e1\n", {}),
            ("0,0.1\n0.5,-2\n1.25,3e1", {}),
            ("0,0.1\r\n0.5,-2\r\n1.25,3e1\r\n", {}),
            ("\ufeff0,0.1\n0.5,-2\n1.25,3e1\n", {}),
            ("time,acceleration\n0,0.1\n0.5,-2\n1.25,3e1\n", {}),
            ('"t, s","a, m/s^2"\n"0","0.1"\n"0.5","-2"\n"1.25","30"\n', {"value_column": "a, m/s^2"}),
            ("# a note, with commas, in it\n\n 0 , 0.1\n0.5, -2\n\n# another\n1.25,30\n,\n", {}),
            ("0;0.1\n0.5;-2\n1.25;30\n", {"delimiter": ";"}),
            ("0\t0.1\n0.5\t-2\n1.25\t30\n", {"delimiter": "\t"}),
            ("  0   0.1\n0.5 -2\n  1.25\t+30.\n", {"delimiter": None}),
            ("9,0.1,0\n9,-2,0.5\n9,30,1.25\n", {"time_column": 2, "value_column": 1}),
            ("x,a,t\n9,0.1,0\n9,-2,0.5\n9,30,1.25\n", {"time_column": "t", "value_column": "a"}),
            ("x,a,t\nn/a,0.1,0\n?,-2,0.5\n,30,1.25\n", {"time_column": "t", "value_column": 1}),
            ("1,2,3\n0,0.1,9\n0.5,-2,9\n1.25,30,9\n", {"time_column": "1", "value_column": "2"}),
        ],
    )
    def test_layouts(self, file, text, options):
        times, values = read_csv(file(text), **options)
        assert times.dtype == values.dtype == np.float64
        assert times.tolist() == TIMES
        assert values.tolist() == VALUES

    def test_path_as_text(self, file):
        assert read_csv(str(file("0,1\n1,2\n")))[1].tolist() == [1.0, 2.0]

    def test_scale(self, file):
        path = file("0,0.1\n0.5,-2\n1.25,30\n")
        assert read_csv(path, scale=0.01)[1] == pytest.approx(0.01 * np.array(VALUES), rel=1e-15)
        assert read_csv(path, scale=-2.0)[1].tolist() == [-0.2, 4.0, -60.0]

    def test_shift(self, file):
        """The first time is subtracted; where it is 0 already, nothing changes."""
        assert read_csv(file("2.5,0.1\n3,-2\n3.75,30\n"), shift=True)[0].tolist() == TIMES
        assert read_csv(file("-0.5,0.1\n0,-2\n0.75,30\n"), shift=True)[0].tolist() == TIMES
        assert read_csv(file("0,0.1\n0.5,-2\n1.25,30\n"), shift=True)[0].tolist() == TIMES

    def test_recorded(self, file):
        motion = read_recorded_csv(
            file("v;t\n0.1;1\n-2;1.5\n30;2.25\n"),
            time_column="t",
            value_column="v",
            scale=2.0,
            delimiter=";",
            shift=True,
        )
        assert isinstance(motion, Recorded)
        assert motion.times.tolist() == TIMES
        assert motion.values.tolist() == [0.2, -4.0, 60.0]
        assert float(motion.value(0.25)) == pytest.approx(-1.9)

    def test_acceleration(self, file):
        motion = read_acceleration_csv(
            file("a;t\n0.1;1\n-2;1.5\n30;2.25\n"), time_column=1, value_column=0, scale=2.0, delimiter=";", shift=True
        )
        assert isinstance(motion, GroundAcceleration)
        assert motion.times.tolist() == TIMES
        assert motion.accelerations.tolist() == [0.2, -4.0, 60.0]

    def test_long_record(self, file):
        times, values = np.arange(20_000) * 0.01, np.sin(np.arange(20_000))
        text = "\n".join(f"{t!r},{v!r}" for t, v in zip(times.tolist(), values.tolist(), strict=True))
        read = read_csv(file(text))
        assert read[0].tolist() == times.tolist()
        assert read[1].tolist() == values.tolist()


class TestTablesRefused:
    @pytest.mark.parametrize("text", ["", "\n\n", "# only a note\n", " \t\n"])
    def test_empty(self, file, text):
        refuses(read_csv, file(text), "is empty")

    @pytest.mark.parametrize(("text", "count"), [("0,1\n", 1), ("t,v\n", 0), ("t,v\n0,1\n", 1)])
    def test_too_few_samples(self, file, text, count):
        refuses(read_csv, file(text), rf"with at least 2 samples, but .* has {count}\.")

    @pytest.mark.parametrize(
        ("text", "pattern"),
        [
            ("0,1\n1,2\n2\n3,4\n", r"in every row, but line 3 of .* has 1 and line 1 has 2; correct"),
            ("t,v\n0,1\n\n1,2,3\n", r"line 4 of .* has 3 and line 1 has 2"),
            ("# note\nt,v,w\n0,1\n1,2\n", r"line 3 of .* has 2 and line 2 has 3"),
        ],
    )
    def test_rows_of_different_lengths(self, file, text, pattern):
        refuses(read_csv, file(text), pattern)

    @pytest.mark.parametrize("text", ["0 1\n1 2\n", "0;1\n1;2\n", "0\n1\n"])
    def test_too_few_columns(self, file, text):
        refuses(
            read_csv, file(text), r"Argument value_column .* from 0 to 0, but 1 was given; if line 1 has more, .*delim"
        )

    def test_column_that_is_not_there(self, file):
        path = file("t,v\n0,1\n1,2\n")
        refuses(lambda p: read_csv(p, time_column=2), path, "Argument time_column .* from 0 to 1, but 2 was given")
        refuses(
            lambda p: read_csv(p, value_column="a"), path, r"Argument value_column .*\['t', 'v'\].* but 'a' was given"
        )
        refuses(
            lambda p: read_csv(p, time_column="t", value_column=3), path, "Argument value_column .* but 3 was given"
        )

    def test_name_that_is_there_twice(self, file):
        refuses(lambda p: read_csv(p, value_column="v"), file("t,v,v\n0,1,2\n1,2,3\n"), "name of one of the columns")

    @pytest.mark.parametrize(
        ("text", "line", "entry"),
        [
            ("0,1\n1,two\n", 2, "two"),
            ("t,v\n0,1\n1,\n", 3, ""),
            ("0,1\n1,nan\n2,3\n", 2, "nan"),
            ("0,NaN\n1,2\n2,3\n", 1, "NaN"),
            ("0,1\n\n1,inf\n2,3\n", 3, "inf"),
            ("0,1\nnan,2\n2,3\n", 2, "nan"),
            ("0,one\n1,2\n", 1, "one"),
            ("t,v\ns,m/s\n0,1\n1,2\n", 2, "s"),
            ("0,1\n1,1_000\n", 2, "1_000"),
            ("0,1\n1,1.0D-3\n", 2, "1.0D-3"),
        ],
    )
    def test_entries_that_are_no_finite_numbers(self, file, text, line, entry):
        refuses(
            read_csv, file(text), rf"finite numbers only, but line {line} of .* has the entry '{entry}'; correct it"
        )

    def test_decimal_comma(self, file):
        refuses(lambda p: read_csv(p, delimiter=";"), file("0;1\n0,5;2\n"), "line 2 of .* has the entry '0,5'")

    @pytest.mark.parametrize(
        ("text", "line", "time", "before"),
        [
            ("0,1\n0.5,2\n0.5,3\n", 3, "0.5", "0.5"),
            ("t,v\n0,1\n\n0.5,2\n0.25,3\n0.75,4\n", 5, "0.25", "0.5"),
            ("1,1\n0,2\n", 2, "0.0", "1.0"),
        ],
    )
    def test_times_that_do_not_increase(self, file, text, line, time, before):
        refuses(read_csv, file(text), rf"in line {line} of .* the time {time} s follows {before} s; sort the lines")

    @pytest.mark.parametrize("read", [read_csv, read_recorded_csv, read_acceleration_csv])
    def test_first_time_is_not_zero(self, file, read):
        refuses(
            read, file("2.5,1\n3,2\n"), r"times that begin with 0, but the first in .* is 2\.5 s; shift=True subtracts"
        )

    @pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
    def test_other_encodings(self, file, encoding):
        """Signs that cannot be read do no harm in a header, but are no numbers."""
        if encoding == "latin-1":
            assert read_csv(file("Zeit,Größe\n0,1\n1,2\n", encoding=encoding))[1].tolist() == [1.0, 2.0]
        else:
            refuses(read_csv, file("0,1\n1,2\n", encoding=encoding), "Argument")

    def test_no_table_at_all(self, file):
        refuses(read_csv, file("x" * 200_000 + ",1\n"), "line 1 of .* is none")


HEADER = "INVENTED STRONG MOTION DATABASE RECORD\nNowhere-01, 1/2/1999, Some Station, 90\n"
IN_G = "ACCELERATION TIME SERIES IN UNITS OF G\n"
VALUES_IN_G = [-0.0012, 0.0034, 0.25, -1.5, 0.0]
DATA = "  -.1200E-02   .3400E-02   .2500E+00\n  -.1500E+01   .0000E+00\n"


def at2(text, name="RSN0.AT2"):
    """Arguments for `file`."""
    return text, name


class TestAT2:
    @pytest.mark.parametrize(
        ("unit", "numbers"),
        [
            (IN_G, "NPTS=      5, DT=   .0050 SEC,\n"),
            (IN_G, "NPTS=  5, DT= .00500 SEC\n"),
            (IN_G, "NPTS=5,DT=0.005\n"),
            (IN_G, "npts =  5 , dt = 5.0e-3 sec\n"),
            (
                "ACCELERATION TIME HISTORY IN UNITS OF G. FILTER POINTS: HP=0.2 Hz  LP=40.0 Hz\n",
                " 5   0.0050  NPTS, DT\n",
            ),
            ("Acceleration time history in units of g\n", "    5    .0050    NPTS, DT (sec)\n"),
            ("ACCELERATION (UNITS: G)\n", "5, 0.005, NPTS, DT\n"),
        ],
    )
    def test_headers(self, file, unit, numbers):
        motion = read_at2(file(*at2(HEADER + unit + numbers + DATA)))
        assert isinstance(motion, GroundAcceleration)
        assert np.asarray(motion.times) == pytest.approx([0, 0.005, 0.01, 0.015, 0.02], rel=1e-15)
        assert np.asarray(motion.accelerations) == pytest.approx(G * np.array(VALUES_IN_G), rel=1e-15)

    @pytest.mark.parametrize("line_end", ["\n", "\r\n"])
    @pytest.mark.parametrize("columns", [1, 2, 8])
    def test_any_number_a_line(self, file, columns, line_end):
        values = np.linspace(-0.3, 0.3, 23)
        rows = [values[start : start + columns] for start in range(0, 23, columns)]
        data = "".join("".join(f"{value:15.7E}" for value in row) + "\n" for row in rows)
        text = f"{HEADER}{IN_G}NPTS= 23, DT= .0100 SEC\n{data}\n\n".replace("\n", line_end)
        motion = read_at2(file(*at2(text)))
        assert np.asarray(motion.accelerations) == pytest.approx(G * values, rel=1e-6)
        assert float(motion.duration) == pytest.approx(0.22, rel=1e-15)

    def test_another_g(self, file):
        motion = read_at2(file(*at2(HEADER + IN_G + "NPTS= 5, DT= .01 SEC\n" + DATA)), g=9.81)
        assert np.asarray(motion.accelerations) == pytest.approx(9.81 * np.array(VALUES_IN_G), rel=1e-15)

    def test_old_encoding_in_a_name(self, file):
        text = HEADER.replace("Some Station", "Zürich") + IN_G + "NPTS= 5, DT= .01 SEC\n" + DATA
        assert len(read_at2(file(text, "RSN0.AT2", encoding="latin-1")).times) == 5


class TestAT2Refused:
    @pytest.mark.parametrize(("count", "held"), [(6, 5), (4, 5)])
    def test_another_number_of_samples(self, file, count, held):
        text = f"{HEADER}{IN_G}NPTS= {count}, DT= .01 SEC\n{DATA}"
        refuses(read_at2, file(*at2(text)), rf"NPTS = {count}, but .* holds {held}; get a whole copy of it")

    @pytest.mark.parametrize("line", ["", "NPTS= 5\n", "DT= .01 SEC\n", "5 .01\n"])
    def test_no_count_or_step(self, file, line):
        refuses(read_at2, file(*at2(HEADER + IN_G + line + DATA)), r"ends with NPTS and DT, .* has no such line")

    @pytest.mark.parametrize(
        "line", ["NPTS= 1, DT= .01 SEC", "NPTS= 0, DT= .01", "NPTS= 5, DT= 0.0", "5 -0.01 NPTS, DT"]
    )
    def test_count_or_step_that_cannot_be(self, file, line):
        refuses(read_at2, file(*at2(f"{HEADER}{IN_G}{line}\n{DATA}")), rf"positive DT, but line 4 of .* is '{line}'")

    @pytest.mark.parametrize(
        ("name", "unit"),
        [
            ("RSN0.VT2", "VELOCITY TIME SERIES IN UNITS OF CM/S"),
            ("RSN0.DT2", "DISPLACEMENT TIME SERIES IN UNITS OF CM"),
            ("RSN0.AT2", "VELOCITY TIME HISTORY IN UNITS OF G-S"),
            ("RSN0.AT2", "ACCELERATION TIME HISTORY IN UNITS OF CM/SEC/SEC"),
            ("RSN0.AT2", "ACCELERATION TIME HISTORY IN CM/SEC/SEC"),
            ("RSN0.AT2", "ACCELERATION TIME SERIES IN UNITS OF GAL"),
            ("RSN0.AT2", "ACCELERATION TIME SERIES IN UNITS OF G/10"),
            ("RSN0.AT2", "ACCELERATION TIME SERIES"),
        ],
    )
    def test_another_quantity_or_unit(self, file, name, unit):
        text = f"{HEADER}{unit}\nNPTS= 5, DT= .01 SEC\n{DATA}"
        refuses(read_at2, file(text, name), rf"in units of g, but the header of .* says '{unit}'; take the AT2 file")

    def test_no_unit(self, file):
        text = HEADER + "NPTS= 5, DT= .01 SEC\n" + DATA
        refuses(
            read_at2, file(*at2(text)), "in units of g, but the header of .* names no unit; if it is g, add the line"
        )

    @pytest.mark.parametrize("entry", ["abc", "nan", "******", "Infinity", ".12-.34"])
    def test_entries_that_are_no_finite_numbers(self, file, entry):
        text = f"{HEADER}{IN_G}NPTS= 5, DT= .01 SEC\n .1 .2\n .3 {entry}\n .5\n"
        refuses(read_at2, file(*at2(text)), r"finite numbers only, but line 6 of .* has the entry '")

    @pytest.mark.parametrize("text", ["", " \n\n"])
    def test_empty(self, file, text):
        refuses(read_at2, file(*at2(text)), "is empty")


@pytest.mark.usefixtures("annotations_unchecked")
class TestBadArguments:
    @pytest.mark.parametrize("read", [read_csv, read_recorded_csv, read_acceleration_csv, read_at2])
    def test_missing_file(self, tmp_path, read):
        refuses(read, tmp_path / "no.csv", "file that exists, but .* the folder looked in is", FileNotFoundError)

    @pytest.mark.parametrize("read", [read_csv, read_recorded_csv, read_acceleration_csv, read_at2])
    def test_long_name_is_shown_whole(self, tmp_path, read):
        folder = tmp_path / ("long" * 40)
        refuses(read, folder / "no.csv", "file that exists, but .* the folder looked in is", FileNotFoundError)
        folder.mkdir()
        refuses(read, folder, "that can be read, but", OSError)

    @pytest.mark.parametrize("read", [read_csv, read_at2])
    def test_folder(self, tmp_path, read):
        refuses(read, tmp_path, "that can be read, but", OSError)

    @pytest.mark.parametrize("read", [read_csv, read_at2])
    @pytest.mark.parametrize("value", [3, None, b"record.csv", ["record.csv"]])
    def test_path(self, read, value):
        with pytest.raises(ValueError, match=r"\AArgument path must be the name of a file, but .* was given\.\Z"):
            read(value)

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            *[(name, value) for name in ("time_column", "value_column") for value in (-1, 1.0, None, True, [0])],
            *[("delimiter", value) for value in ("", ", ", 3, "\n", '"')],
            *[("scale", value) for value in (float("nan"), float("inf"), "2", None, [1.0])],
        ],
    )
    def test_options(self, file, name, value):
        path = file("0,1\n1,2\n")
        for read in (read_csv, read_recorded_csv, read_acceleration_csv):
            if name == "scale" and value is None and read is read_acceleration_csv:
                continue  # not stated
            with pytest.raises(ValueError, match=rf"\AArgument {name} must be .*, but .* was given\.\Z"):
                read(path, **{name: value})

    @pytest.mark.parametrize("value", [0.0, -9.81, float("nan"), "9.81", None])
    def test_g(self, file, value):
        path = file(*at2(HEADER + IN_G + "NPTS= 5, DT= .01 SEC\n" + DATA))
        with pytest.raises(ValueError, match=r"\AArgument g must be .*, but .* was given\.\Z"):
            read_at2(path, g=value)


def quake(peak, drift=0.0, points=400):
    """Times and accelerations without a final velocity, but for that of a constant `drift` (m/s^2)."""
    times = 0.01 * np.arange(points)
    pulse = np.sin(4 * np.pi * times / times[-1])
    return times, peak * pulse / np.max(np.abs(pulse)) + drift


def rows(times, values):
    return "\n".join(f"{t!r},{v!r}" for t, v in zip(times.tolist(), values.tolist(), strict=True))


class TestWhatLooksOdd:
    def test_a_sane_record_is_read_quietly(self, file):
        """Warnings are errors in tests."""
        read_acceleration_csv(file(rows(*quake(3.0))))
        read_acceleration_csv(file(rows(*quake(0.1))), scale=1.0)
        read_acceleration_csv(file(rows(*quake(0.3))), scale=9.80665)

    def test_values_in_g(self, file):
        with pytest.warns(RuntimeWarning, match=r"largest acceleration is 0.35 m/s\^2, or is it in g\? Give scale=9.8"):
            read_acceleration_csv(file(rows(*quake(0.35))))

    def test_a_baseline(self, file):
        with pytest.warns(
            RuntimeWarning, match=r"ends with a velocity of 0.798 m/s, of at most .*correct its baseline"
        ):
            read_acceleration_csv(file(rows(*quake(3.0, drift=0.2))))
        text = f"{HEADER}{IN_G}NPTS= 400, DT= .01 SEC\n" + " ".join(map(repr, quake(0.3, 0.02)[1].tolist()))
        with pytest.warns(RuntimeWarning, match="looks odd: the ground ends with a velocity of 0.783 m/s"):
            read_at2(file(*at2(text)))

    def test_a_gap(self, file):
        times, values = quake(3.0)
        keep = (times < 1.0) | (times > 1.035)
        with pytest.warns(
            RuntimeWarning, match=r"points are 0.01 s apart, but 0.99 s and 1.04 s are not; between them"
        ):
            read_acceleration_csv(file(rows(times[keep], values[keep])))
