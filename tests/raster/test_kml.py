"""Polygons in KML and KMZ: what is taken, what is passed over aloud, what is refused by name."""

from __future__ import annotations

import contextlib
import json
import zipfile
from pathlib import Path

import pytest
import shapely

from hrt_cli.errors import InputError
from hrt_cli.raster.aoi import read_aoi
from hrt_cli.raster.kml import read_kml

SQUARE = "8.0,47.0,0 8.001,47.0,0 8.001,47.001,0 8.0,47.001,0 8.0,47.0,0"
HOLE = "8.0002,47.0002 8.0004,47.0002 8.0004,47.0004 8.0002,47.0004 8.0002,47.0002"
FAR = "9.0,47.0,412.5 9.001,47.0,412.5 9.001,47.001,412.5 9.0,47.0,412.5"
OPENGIS = "http://www.opengis.net/kml/2.2"


def ring(coordinates: str) -> str:
    return f"<LinearRing>\n<coordinates>\n{coordinates}\n</coordinates></LinearRing>"


def polygon(outer: str = SQUARE, *holes: str) -> str:
    inner = "".join(f"<innerBoundaryIs>{ring(hole)}</innerBoundaryIs>" for hole in holes)
    return f"<Polygon><tessellate>1</tessellate><outerBoundaryIs>{ring(outer)}</outerBoundaryIs>{inner}</Polygon>"


def placemark(*inside: str) -> str:
    return f"<Placemark><name>a &amp; b</name>{''.join(inside)}</Placemark>"


def kml(*inside: str, namespace: str = OPENGIS) -> str:
    declared = f' xmlns="{namespace}"' if namespace else ""
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<kml{declared}>{"".join(inside)}</kml>'


def written(folder: Path, text: str, name: str = "area.kml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def shape_of(*rings: str) -> shapely.Polygon:
    outer, *holes = [[tuple(map(float, p.split(",")[:2])) for p in each.split()] for each in rings]
    return shapely.Polygon(outer, holes)


POINT = "<Point><coordinates>8.0005,47.0005,0</coordinates></Point>"


class TestRead:
    @pytest.mark.parametrize(
        "namespace",
        [
            "",
            *(f"http://www.opengis.net/kml/2.{minor}" for minor in (2, 3)),
            *(f"http://earth.google.com/kml/2.{minor}" for minor in (0, 1, 2)),
        ],
    )
    def test_every_version_of_the_namespace(self, tmp_path: Path, namespace: str) -> None:
        path = written(tmp_path, kml(placemark(polygon(SQUARE, HOLE)), namespace=namespace))
        assert read_aoi(path).shape.equals(shape_of(SQUARE, HOLE))
        assert read_aoi(path).crs.to_epsg() == 4326

    @pytest.mark.parametrize(
        "wrap", ["{}", "<Document>{}</Document>", "<Document><Folder><Folder>{}</Folder></Folder></Document>"]
    )
    @pytest.mark.parametrize("collection", ["{}", "<MultiGeometry>{}</MultiGeometry>"])
    def test_polygons_wherever_they_are_filed(self, tmp_path: Path, wrap: str, collection: str) -> None:
        inside = placemark(collection.format(polygon(SQUARE, HOLE))) + placemark(polygon(FAR))
        inside = inside.replace(
            "</Polygon></MultiG", f"</Polygon><MultiGeometry>{polygon(FAR)}</MultiGeometry></MultiG"
        )
        found = read_aoi(written(tmp_path, kml(wrap.format(inside))))
        assert found.shape.equals(shapely.union(shape_of(SQUARE, HOLE), shape_of(FAR)))
        assert not found.notes

    def test_it_is_the_area_that_geojson_gives(self, tmp_path: Path) -> None:
        rings = [[list(p) for p in r.coords] for r in (shape_of(SQUARE).exterior, shape_of(HOLE).exterior)]
        path = tmp_path / "a.geojson"
        path.write_text(json.dumps({"type": "Polygon", "coordinates": rings}))
        same = read_aoi(written(tmp_path, kml(placemark(polygon(SQUARE, HOLE))), "A.KML"))
        assert same.shape.equals_exact(read_aoi(path).shape)

    def test_what_google_earth_writes_beside_it_has_no_meaning(self, tmp_path: Path) -> None:
        style = '<Style id="s"><PolyStyle><color>7f0000ff</color></PolyStyle></Style>'
        look = "<LookAt><longitude>1</longitude><latitude>2</latitude><gx:altitudeMode>a</gx:altitudeMode></LookAt>"
        overlay = "<GroundOverlay><LatLonBox><north>48</north></LatLonBox></GroundOverlay>"
        data = "<ExtendedData><Data name='coordinates'><value>1,2 3,4</value></Data></ExtendedData><coordinates>9"
        text = kml(f"<Document>{style}{overlay}", placemark(look, data, "</coordinates>", polygon()), "</Document>")
        text = text.replace("<kml ", '<kml xmlns:gx="http://www.google.com/kml/ext/2.2" ')
        text = text.replace("8.001,47.001,0", "<!-- a comment --><![CDATA[8.001,47.001,0]]>")
        found = read_aoi(written(tmp_path, text))
        assert found.shape.equals(shape_of(SQUARE))
        assert not found.notes

    def test_labels_are_passed_over_aloud(self, tmp_path: Path) -> None:
        path = written(tmp_path, kml("<Folder>", placemark(POINT), placemark(polygon()), placemark(), "</Folder>"))
        found = read_aoi(path)
        assert found.shape.equals(shape_of(SQUARE))
        assert found.notes == ("placemarks that are points, or hold no shape, are passed over: 2",)

    def test_hidden_polygons_count_aloud(self, tmp_path: Path) -> None:
        hidden = "<visibility>0</visibility>"
        folder = f"<Folder>{hidden}{placemark(polygon(FAR))}</Folder>"
        path = written(
            tmp_path, kml("<Document>", folder, placemark(hidden, polygon()), placemark(polygon()), "</Document>")
        )
        found = read_aoi(path)
        assert found.shape.equals(shapely.union(shape_of(SQUARE), shape_of(FAR)))
        assert found.notes == ("polygons that are hidden (visibility 0) count all the same: 2",)

    def test_what_a_peer_writes(self, tmp_path: Path) -> None:
        fastkml = pytest.importorskip("fastkml")
        shape = shapely.MultiPolygon([shape_of(SQUARE, HOLE), shape_of(FAR)])
        document = fastkml.KML(features=[fastkml.Document(features=[fastkml.Placemark(geometry=shape)])])
        assert read_aoi(written(tmp_path, document.to_string(precision=6))).shape.equals(shape)


LINE = f"<LineString><coordinates>{SQUARE}</coordinates></LineString>"
TRACK = "<gx:Track xmlns:gx='http://www.google.com/kml/ext/2.2'><gx:coord>8 47 0</gx:coord></gx:Track>"
GOOD = placemark(polygon())
BAD: dict[str, tuple[str, str]] = {
    "empty": ("", "is not XML that can be read: no element found"),
    "json": ("{}", "is not XML that can be read"),
    "cut": (kml(GOOD)[:-40], "is not XML that can be read"),
    "gpx": ('<gpx xmlns="http://www.topografix.com/GPX/1/1"/>', "is not KML: it begins with an element .*gpx"),
    "another namespace": (kml(GOOD, namespace="http://example.org/kml"), "is not KML: it begins with"),
    "no root": (GOOD, "is not KML: it begins with an element Placemark"),
    "nothing in it": (kml(), "holds no polygon"),
    "points only": (kml(placemark(POINT)), "holds no polygon"),
    "a doctype": ('<!DOCTYPE kml [<!ENTITY a "8.0">]>' + kml(GOOD)[39:], "declares a document type or entities"),
    "an entity": (kml(placemark(polygon(SQUARE.replace("8.0,", "&a;,")))), "undefined entity"),
    "a line": (kml(GOOD, placemark(LINE)), "holds a LineString; an area is made of Polygons"),
    "a ring alone": (kml(GOOD, placemark(ring(SQUARE))), "holds a LinearRing; an area is made of Polygons"),
    "a track": (kml(GOOD, placemark(TRACK)), "holds a Track"),
    "a model": (kml(GOOD, placemark("<Model/>")), "holds a Model"),
    "a link": (kml(GOOD, "<NetworkLink><Link><href>b.kml</href></Link></NetworkLink>"), "holds a NetworkLink, to what"),
    "a polygon astray": (kml(GOOD, f"<Document>{polygon()}</Document>"), "a Polygon stands in a Document"),
    "a polygon in itself": (
        kml(placemark(f"<Polygon>{polygon()}</Polygon>")), "a Polygon stands in a Polygon"),
    "a boundary astray": (kml(placemark(f"<innerBoundaryIs>{ring(HOLE)}</innerBoundaryIs>")), "stands in a Placemark"),
    "no ring": (kml(placemark("<Polygon/>")), "a polygon without rings"),
    "only a hole": (kml(placemark(polygon(SQUARE).replace("outer", "inner"))), "a polygon without rings"),
    "two outer rings": (kml(placemark(polygon(SQUARE, FAR).replace("inner", "outer"))), "several outer rings"),
    "a ring of nothing": (kml(placemark(polygon(""))), "fewer than four positions"),
    "no coordinates": (kml(placemark(polygon()).replace("coordinates", "coordinate")), "fewer than four positions"),
    "coordinates cut by an element": (kml(placemark(polygon(SQUARE + "<b/>"))), "fewer than four positions"),
    "open": (kml(placemark(polygon(SQUARE.rsplit(" ", 1)[0]))), "not closed"),
    "a bow tie": (kml(placemark(polygon("8,47 9,48 9,47 8,48 8,47"))), "not valid: Self-intersection at 8.5 47.5"),
    "a hole outside": (kml(placemark(polygon(SQUARE, FAR))), "not valid: Hole lies outside"),
    "blanks after commas": (kml(placemark(polygon(SQUARE.replace(",", ", ")))), "position '8.0,', which is not"),
    "a comma for a point": (kml(placemark(polygon(SQUARE.replace(".", ",")))), "which is not of the form lon,lat"),
    "nan": (kml(placemark(polygon(SQUARE.replace("47.001", "nan")))), "position '8.001,nan,0', which is not"),
    "infinity": (kml(placemark(polygon(SQUARE.replace("47.001", "1e999")))), "is no longitude and latitude"),
    "other digits": (kml(placemark(polygon(SQUARE.replace("8", "٨")))), "which is not of the form"),
    "exchanged": (kml(placemark(polygon(SQUARE.replace("8.0", "147.0").replace("47.0", "105.0")))), "longitude first"),
    "too deep": (kml("<Folder>" * 70, GOOD, "</Folder>" * 70), "nested deeper than 64 levels"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_area_is_refused_by_name(tmp_path: Path, name: str) -> None:
    text, problem = BAD[name]
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=problem) as refusal:
        read_aoi(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < len(str(path)) + 200


def test_a_file_that_is_not_there_or_no_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_aoi(tmp_path / "a.kml")
    with pytest.raises(InputError, match="no such file"):
        read_aoi(tmp_path / "a.kmz")
    (tmp_path / "b.kml").write_bytes(kml(GOOD).encode("utf-16"))
    with pytest.raises(InputError, match="is not a UTF-8 text file"):
        read_aoi(tmp_path / "b.kml")


def test_too_many_positions_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, kml(placemark(polygon(SQUARE, HOLE))))
    monkeypatch.setattr("hrt_cli.raster.polygons.MAX_POSITIONS", 10)
    assert len(read_kml(path).polygons) == 1
    for most in (9, 4):
        monkeypatch.setattr("hrt_cli.raster.polygons.MAX_POSITIONS", most)
        with pytest.raises(InputError, match=f"more than {most} positions"):
            read_kml(path)


class TestKmz:
    def zipped(self, folder: Path, **files: str) -> Path:
        path = folder / "area.kmz"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, text in files.items():
                archive.writestr(name.replace("_", ".").replace("0", "/"), text)
        return path

    def test_doc_kml_is_the_main_one(self, tmp_path: Path) -> None:
        path = self.zipped(tmp_path, files0other_kml=kml(placemark(polygon(FAR))), doc_kml=kml(GOOD), a_png="x")
        assert read_aoi(path).shape.equals(shape_of(SQUARE))

    def test_and_else_the_only_one(self, tmp_path: Path) -> None:
        assert read_aoi(self.zipped(tmp_path, area_KML=kml(GOOD), a_png="x")).shape.equals(shape_of(SQUARE))

    @pytest.mark.parametrize("files", [{}, {"a_kml": kml(GOOD), "b_kml": kml(GOOD)}])
    def test_without_a_main_one_it_is_refused(self, tmp_path: Path, files: dict[str, str]) -> None:
        with pytest.raises(InputError, match=f"holds {len(files)} KML files, of which none is the main one"):
            read_aoi(self.zipped(tmp_path, **files))

    def test_damage_is_refused(self, tmp_path: Path) -> None:
        path = self.zipped(tmp_path, doc_kml=kml(GOOD))
        whole = path.read_bytes()
        for at in range(0, len(whole), 3):
            path.write_bytes(whole[:at])
            with pytest.raises(InputError, match=r"area\.kmz: "):
                read_aoi(path)
            path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
            with contextlib.suppress(InputError):
                assert read_aoi(path).shape.equals(shape_of(SQUARE))  # a time stamp, or the like

    def test_a_bomb_is_refused(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("hrt_cli.raster.kml.MAX_BYTES", 10_000)
        path = self.zipped(tmp_path, doc_kml=kml(GOOD) + " " * 10_000)
        assert path.stat().st_size < 10_000
        with pytest.raises(InputError, match="holds a KML of more than the 10000 bytes"):
            read_aoi(path)
        path = self.zipped(tmp_path, doc_kml=kml(GOOD), a_txt="".join(map(chr, range(100, 9000))))
        with pytest.raises(InputError, match="is more than the 10000 bytes"):
            read_aoi(path)
