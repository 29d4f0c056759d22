"""Tracks of other programs: every format by a hand-made file, its oddities, hostile files."""

import numpy as np
import pytest

import cellsys as cs
from cellsys.tracks import chained

XML = """<?xml version="1.0" encoding="UTF-8"?>
<TrackMate version="7.0"><Model spatialunits="micron" timeunits="sec"><AllSpots nspots="7">
{spots}</AllSpots><AllTracks><Track TRACK_ID="5">{edges}</Track>
<Track TRACK_ID="6"><Edge SPOT_SOURCE_ID="20" SPOT_TARGET_ID="21"/></Track></AllTracks>
<FilteredTracks><TrackID TRACK_ID="5"/></FilteredTracks></Model></TrackMate>"""
# A cell that divides in its first frame; one daughter is missed for a frame; both merge again.
SPOTS = {10: (0, 0, 0), 11: (1, 1, 1), 12: (1, 1, -1), 13: (2, 2, 2), 14: (3, 3, 0), 20: (0, 9, 9),
         21: (1, 9, 8), 30: (0, 5, 5)}  # fmt: skip
EDGES = [(10, 11), (10, 12), (11, 13), (13, 14), (12, 14)]


def trackmate(path, head="", spots=SPOTS, edges=EDGES):
    rows = "".join(
        f'<Spot ID="{i}" FRAME="{f}" POSITION_T="{30 * f}" POSITION_X="{x}" POSITION_Y="{y}" '
        f'POSITION_Z="0" QUALITY="1.5"/>\n' for i, (f, x, y) in spots.items()
    )  # fmt: skip
    links = "".join(f'<Edge SPOT_SOURCE_ID="{i}" SPOT_TARGET_ID="{j}"/>' for i, j in edges)
    text = XML.format(spots=rows, edges=links)
    path.write_text(text.replace("<TrackMate", head + "<TrackMate", 1))
    return path


def test_trackmate_xml_keeps_splits_merges_and_gaps(tmp_path):
    tracks = cs.read_tracks(trackmate(tmp_path / "a.xml"))
    assert (tracks.length_unit, tracks.time_unit) == ("um", "s")
    assert len(tracks) == 5  # the other track was filtered out, one spot is of no track
    assert tracks.source["untracked_spots"] == 3
    assert np.array_equal(tracks.track, [5] * 5)
    assert np.array_equal(tracks.t, 30.0 * tracks.frame)
    assert [len(v) for v in (tracks.splits, tracks.merges, tracks.gaps)] == [1, 1, 1]
    assert tracks.frame[tracks.splits[0]] == 0
    assert list(tracks.cells) == ["5", "5.1", "5.2", "5.3"]
    assert sorted(len(rows) for rows in tracks.cells.values()) == [1, 1, 1, 2]
    assert np.array_equal(tracks.features["QUALITY"], [1.5] * 5)


def test_short_trackmate_xml(tmp_path):
    (tmp_path / "a.xml").write_text(
        '<Tracks nTracks="2" spaceUnits="pixel" frameInterval="2.5" timeUnits="min">'
        '<particle nSpots="2"><detection t="0" x="1" y="2" z="0"/><detection t="2" x="3" y="4" '
        'z="0"/></particle><particle nSpots="1"><detection t="1" x="5" y="6" z="0"/></particle>'
        "</Tracks>"
    )
    tracks = cs.read_tracks(tmp_path / "a.xml", pixel_size=0.5)
    assert np.array_equal(tracks.t, [0.0, 300.0, 150.0])  # 2.5 min a frame
    assert np.array_equal(tracks.place[:, 0], [0.5, 1.5, 2.5])
    assert len(tracks.gaps) == 1
    assert len(tracks.cells) == 2  # a track of one frame is one


BTRACK = "t,x,y,z,ID,parent,root,state\n" + "".join(
    f"{t},{x},{y},0,{i},{p},1,5\n"
    for t, x, y, i, p in [(0, 0, 0, 1, 1), (1, 1, 0, 1, 1), (2, 1, 1, 2, 1), (2, 1, -1, 3, 1),
                          (3, 2, 2, 2, 1)]
)  # fmt: skip


def test_btrack_divides(tmp_path):
    (tmp_path / "a.csv").write_text(BTRACK)
    tracks = cs.read_tracks(tmp_path / "a.csv", frame_interval=60.0, pixel_size=2.0)
    assert len(tracks.splits) == 1
    assert tracks.frame[tracks.splits[0]] == 1
    assert len(tracks.cells) == 3
    assert np.array_equal(tracks.times("1"), [0.0, 60.0])
    assert np.array_equal(tracks.path("2"), [[2.0, 2.0, 0.0], [4.0, 4.0, 0.0]])


def test_objects_without_tracks_are_linked_on_request(tmp_path):
    rows = [f"{t},{x + 0.3 * t},{x},0,5,0\n" for t in range(4) for x in (0, 10, 20)]
    (tmp_path / "a.csv").write_text("t,x,y,z,states,label\n" + "".join(rows))
    loose = cs.read_tracks(tmp_path / "a.csv")
    assert loose.source["tracked"] is False
    assert len(loose.cells) == 12
    joined = cs.read_tracks(tmp_path / "a.csv", link_within=2.0)
    assert sorted(len(r) for r in joined.cells.values()) == [4, 4, 4]
    assert all(np.ptp(joined.path(c)[:, 1]) == 0 for c in joined.cells)
    assert len(cs.read_tracks(tmp_path / "a.csv", link_within=0.2).links) == 0


@pytest.mark.parametrize(
    ("head", "units", "scale"),
    [
        ("id,t,x,y", ("px", "frame"), 1.0),  # celltrackR
        ("\ufeffTRACK;time [min];x [µm];y [µm]", ("um", "s"), 60.0),
        ("particle\tframe\tx (nm)\ty (nm)", ("um", "frame"), 1.0),  # TrackPy, in nm
        ("ID,t (ms),POSITION_X (micron),POSITION_Y (micron)", ("um", "s"), 1e-3),
    ],
)
def test_tables_by_the_names_of_their_columns(tmp_path, head, units, scale):
    sign = next((s for s in ";\t" if s in head), ",")
    rows = [("a", 0, 1, 2), ("b", 0, 3, 4), ("a", 1, 5, 6), ("a", 3, 7, 8)]
    text = "\n".join([head, *(sign.join(map(str, r)) for r in rows)])
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    tracks = cs.read_tracks(tmp_path / "a.csv")
    assert (tracks.length_unit, tracks.time_unit) == units
    assert np.array_equal(tracks.t, scale * np.array([0, 0, 1, 3]))
    assert list(map(len, tracks.cells.values())) == [3, 1]
    assert len(tracks.gaps) == 1
    per = 1e-3 if "nm" in head else 1.0
    assert np.array_equal(tracks.path("0")[:, 0], per * np.array([1.0, 5.0, 7.0]))


def test_columns_by_name_and_features(tmp_path):
    (tmp_path / "a.csv").write_text("who,when,east,north,size,film\n1,0,1,2,9,A\n1,1,2,3,,B\n")
    tracks = cs.read_tracks(
        tmp_path / "a.csv", columns={"track": "who", "t": "when", "x": "east", "y": "north"}
    )
    assert np.array_equal(tracks.path("1")[:, :2], [[1, 2], [2, 3]])
    assert np.isnan(tracks.features["size"][1])
    assert "film" not in tracks.features
    with pytest.raises(cs.FileFormatError, match=r"no column of t .*'when'"):
        cs.read_tracks(tmp_path / "a.csv")
    with pytest.raises(cs.ParameterError, match=r"no column of a\.csv"):
        cs.read_tracks(tmp_path / "a.csv", columns={"track": "whom"})


def test_trackmate_tables_with_their_rows_of_units(tmp_path):
    (tmp_path / "spots.csv").write_text(
        "LABEL,ID,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_T,FRAME\n"
        "Label,Spot ID,Track ID,Quality,X,Y,T,Frame\nLabel,Spot ID,Track ID,Quality,X,Y,T,Frame\n"
        ",,,(quality),(micron),(micron),(sec),\n"
        + "".join(
            f"ID{i},{i},{5 if i < 20 else ''},1,{x},{y},{2.0 * f},{f}\n"
            for i, (f, x, y) in SPOTS.items()
        )
    )
    (tmp_path / "edges.csv").write_text(
        "LABEL,TRACK_ID,SPOT_SOURCE_ID,SPOT_TARGET_ID\nLabel,Track ID,Source,Target\n,,,\n"
        + "".join(f"a,5,{i},{j}\n" for i, j in EDGES)
    )
    tracks = cs.read_tracks(tmp_path / "spots.csv", edges=tmp_path / "edges.csv")
    assert (tracks.length_unit, tracks.time_unit) == ("um", "s")
    assert [len(v) for v in (tracks.splits, tracks.merges, tracks.gaps)] == [1, 1, 1]
    assert tracks.source["untracked_spots"] == 3
    with pytest.raises(cs.DataError, match="two spots in frame 1"):
        cs.read_tracks(tmp_path / "spots.csv")


def test_edges_that_hold_their_ends(tmp_path):
    head = "source_frame,source_position_x,source_position_y"
    rows = [
        f"{k},{i},{j},{','.join(map(str, SPOTS[i]))},{','.join(map(str, SPOTS[j]))}"
        for k, (i, j) in enumerate(EDGES)
    ]
    text = f",spot_source_id,spot_target_id,{head},{head.replace('source', 'target')}\n"
    (tmp_path / "edges.csv").write_text(text + "\n".join(rows))
    tracks = cs.read_tracks(tmp_path / "edges.csv")
    assert len(tracks) == 5
    assert [len(v) for v in (tracks.splits, tracks.merges, tracks.gaps)] == [1, 1, 1]


def test_cmso_objects_and_links(tmp_path):
    (tmp_path / "objects.csv").write_text(
        "cmso_object_id,cmso_frame_id,cmso_x_coord,cmso_y_coord\n"
        + "".join(f"{i},{f},{x},{y}\n" for i, (f, x, y) in SPOTS.items())
    )
    lines = [
        (0, 10),
        (0, 11),
        (0, 13),
        (0, 14),
        (1, 10),
        (1, 12),
        (1, 14),
        (2, 20),
        (2, 21),
        (3, 30),
    ]
    (tmp_path / "links.csv").write_text(
        "cmso_link_id,cmso_object_id\n" + "".join(f"{a},{b}\n" for a, b in lines)
    )
    tracks = cs.read_tracks(tmp_path)
    assert len(np.unique(tracks.track)) == 3
    assert [len(v) for v in (tracks.splits, tracks.merges, tracks.gaps)] == [1, 1, 1]


def test_challenge_needs_its_masks_and_reads_them(tmp_path):
    text = tmp_path / "res_track.txt"
    text.write_text("1 0 1 0\n2 2 2 1\n3 2 2 1\n")
    with pytest.raises(cs.FileFormatError, match="masks"):
        cs.read_tracks(text)
    tifffile = pytest.importorskip("tifffile")
    for frame, boxes in enumerate([{1: (2, 2)}, {1: (4, 2)}, {2: (6, 1), 3: (6, 6)}]):
        image = np.zeros((12, 12), np.uint16)
        for label, (x, y) in boxes.items():
            image[y : y + 3, x : x + 3] = label
        tifffile.imwrite(tmp_path / f"mask{frame:03d}.tif", image)
    for path in (text, tmp_path):
        tracks = cs.read_tracks(path)
        assert len(tracks.splits) == 1
        assert np.array_equal(tracks.path("1")[:, :2], [[3, 3], [5, 3]])
    text.write_text("1 0 1 0\n2 2 2 1\n")
    with pytest.raises(cs.FileFormatError, match="no track for label 3"):
        cs.read_tracks(text)
    text.write_text("1 0 1\n")
    with pytest.raises(cs.FileFormatError, match="line 1"):
        cs.read_tracks(text)


def test_geff(tmp_path):
    geff = pytest.importorskip("geff")
    networkx = pytest.importorskip("networkx")
    graph = networkx.DiGraph()
    for i, (f, x, y) in SPOTS.items():
        graph.add_node(i, t=f, x=float(x), y=float(y))
    graph.add_edges_from(EDGES)
    geff.write(
        graph, tmp_path / "a.geff", axis_names=["t", "x", "y"],
        axis_types=["time", "space", "space"], axis_units=["frame", "micrometer", "micrometer"],
    )  # fmt: skip
    tracks = cs.read_tracks(tmp_path / "a.geff")
    assert (tracks.length_unit, tracks.time_unit) == ("um", "frame")
    assert [len(v) for v in (tracks.splits, tracks.merges, tracks.gaps)] == [1, 1, 1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("track,t,x\n1,0,1\n", "no column of y"),
        ("track,t,x,y\n1,0,1\n", "line 2: 3 cells"),
        ("track,t,x,y\n1,0,1,2\n1,1,x,2\n", "line 3, column 'x'"),
        ("track,t,x,y\n1,0,1,2\n1,1,,2\n", "line 3, column 'x'"),
        ("track,t,x,y\n1,0,1,2\n1,0,3,4\n", "track 1 has two spots in frame 0"),
        ("track,t,x [um],y\n1,0,1,2\n", "the same unit"),
        ("track,t [fortnight],x,y\n1,0,1,2\n", "no unit of time"),
        ("track,t,x,y\n1,0.5,1,2\n1,1.7,1,2\n", "whole numbers of frames"),
        ("x,x,y\n1,2,3\n", "two columns are called 'x'"),
    ],
)
def test_bad_tables_say_where(tmp_path, text, words):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises((cs.FileFormatError, cs.DataError), match=words):
        cs.read_tracks(tmp_path / "a.csv")


def test_a_table_without_rows_has_no_tracks(tmp_path):
    (tmp_path / "a.csv").write_text("track,t,x,y\n")
    assert len(cs.read_tracks(tmp_path / "a.csv")) == 0
    assert str(cs.read_tracks(tmp_path / "a.csv")) == "Tracks: no spot"


BOMB = ('<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">'
        '<!ENTITY c SYSTEM "file:///etc/passwd">]>\n')  # fmt: skip


def test_hostile_files_are_refused_before_they_are_read(tmp_path):
    with pytest.raises(cs.FileFormatError, match="document type"):
        cs.read_tracks(trackmate(tmp_path / "a.xml", head=BOMB))
    path = trackmate(tmp_path / "b.xml")
    path.write_text(path.read_text().replace('nspots="7"', 'nspots="99999999999"'))
    with pytest.raises(cs.FileFormatError, match="at most"):
        cs.read_tracks(path)
    (tmp_path / "c.xml").write_text('<Tracks nTracks="1000000" frameInterval="1"></Tracks>')
    with pytest.raises(cs.FileFormatError, match="1000000 tracks; at most"):
        cs.read_tracks(tmp_path / "c.xml")
    for name in ("a.pkl", "a.pickle"):
        (tmp_path / name).write_bytes(b"cos\nsystem\n(S'false'\ntR.")
        with pytest.raises(cs.FileFormatError, match="never read"):
            cs.read_tracks(tmp_path / name)
    with pytest.raises(cs.FileFormatError, match="no XML"):
        (tmp_path / "d.xml").write_text("<a><b></a>") and cs.read_tracks(tmp_path / "d.xml")
    with pytest.raises(cs.FileFormatError, match="not of TrackMate"):
        (tmp_path / "e.xml").write_text("<a></a>") and cs.read_tracks(tmp_path / "e.xml")


def test_a_link_that_is_no_link_is_refused(tmp_path):
    with pytest.raises(cs.FileFormatError, match="names spot 99"):
        cs.read_tracks(trackmate(tmp_path / "a.xml", edges=[*EDGES, (13, 99)]))
    with pytest.raises(cs.DataError, match="forward in time"):
        cs.read_tracks(trackmate(tmp_path / "b.xml", edges=[*EDGES, (11, 12)]))


def test_scales_are_obeyed_or_refused(tmp_path):
    tracks = cs.read_tracks(trackmate(tmp_path / "a.xml"))
    with pytest.raises(cs.ParameterError, match="in um already"):
        tracks.scaled(pixel_size=0.5)
    with pytest.raises(cs.ParameterError, match="in s already"):
        cs.read_tracks(tmp_path / "a.xml", frame_interval=3.0)
    with pytest.raises(cs.ParameterError, match="edges"):
        cs.read_tracks(tmp_path / "a.xml", edges=tmp_path / "a.csv")
    with pytest.raises(cs.UnknownNameError, match="no cell 'z'"):
        tracks.path("z")


def test_a_large_table_is_read_whole(tmp_path):
    track, frame = np.repeat(np.arange(200), 100), np.tile(np.arange(100), 200)
    rows = zip(track.tolist(), frame.tolist(), strict=True)
    text = "".join(f"{a},{b},{0.1 * b:.3f},{0.2 * a:.3f}\n" for a, b in rows)
    (tmp_path / "a.csv").write_text("track,t,x,y\n" + text)
    tracks = cs.read_tracks(tmp_path / "a.csv")
    assert len(tracks.cells) == 200
    assert len(chained(tracks.track, tracks.frame)) == 19_800
