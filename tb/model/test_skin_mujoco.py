# SPDX-License-Identifier: Apache-2.0
"""Examples that run: bodies on MuJoCo's touch_grid and tactile sensors, read and decoded by a skin in every step."""

import numpy as np
import pytest

from dermis.simulators import tactile, touch_grid
from dermis.skin import Skin

pytestmark = pytest.mark.long  # `make test LONG=1` installs mujoco
mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed (pip install mujoco; 64 MB unpacked)")

BALL_N, BOX_N = 0.4 * 9.81, 1.6 * 9.81
WORLD = """
<mujoco>
  <extension><plugin plugin="mujoco.sensor.touch_grid"/></extension>
  <option timestep="0.002"/>
  <worldbody>
    <body name="pad">
      <geom type="box" size="0.04 0.04 0.005"/>
      <site name="touch" pos="0 0 0.05"/>
    </body>
    <body pos="-0.014 -0.013 0.018"><freejoint/><geom type="sphere" size="0.012" mass="0.4"/></body>
    <body pos="0.015 0.011 0.012"><freejoint/><geom type="box" size="0.011 0.009 0.006" mass="1.6"/></body>
  </worldbody>
  <sensor>
    <clock/>
    <plugin name="pad" plugin="mujoco.sensor.touch_grid" objtype="site" objname="touch">
      <config key="size" value="16 12"/><config key="fov" value="45 45"/>
      <config key="gamma" value="0"/><config key="nchannel" value="3"/>
    </plugin>
  </sensor>
</mujoco>
"""


def test_a_ball_and_a_box_on_a_touch_grid_are_weighed() -> None:
    model = mujoco.MjModel.from_xml_string(WORLD)
    data = mujoco.MjData(model)
    skin = Skin("single_touch", array={"rows": 12, "cols": 16})
    for _ in range(500):
        mujoco.mj_step(model, data)
        touch = touch_grid(model, data.sensordata, "pad", 12, 16)
        codes = skin.read(touch, model.opt.timestep)
        found = skin.decode(codes, model.opt.timestep)
        full = codes == 255
        # Forces on the edge of an interval round by some 1e-15 either way.
        assert ((found.low_n <= touch * (1 + 1e-9)) & (touch <= found.high_n * (1 + 1e-9))).all()
        assert np.isinf(found.high_n[full]).all()
    # A point of the ball and four corners of the box, each to half a code of 15 N / 255.
    assert (touch > 0.1).sum() == 5
    assert found.force_n[touch > 0.1] == pytest.approx(touch[touch > 0.1], abs=0.03)
    assert touch.sum() == pytest.approx(BALL_N + BOX_N, rel=0.01)
    # Neighbours in the rows and columns of a contact read up to a code.
    assert found.force_n.sum() == pytest.approx(touch.sum(), abs=0.03 * (codes > 0).sum())
    # The ball lies at x and y below 0, where rows and columns begin; the box on the other side.
    r, c = np.nonzero(touch > 0.1)
    ball = (r < 6) & (c < 8)
    # As the sum above.
    assert touch[r[ball], c[ball]].sum() == pytest.approx(BALL_N, rel=0.01)
    many = touch_grid(model, np.stack([data.sensordata, data.sensordata]), "pad", 12, 16)
    assert np.array_equal(many[1], touch)
    for wrong in (("pad", 16, 12), ("pad", 8, 24), ("no", 12, 16)):
        with pytest.raises(ValueError, match="sensor"):
            touch_grid(model, data.sensordata, *wrong)
    with pytest.raises(ValueError, match="sensordata must be"):
        touch_grid(model, data.sensordata[1:], "pad", 12, 16)
    with pytest.raises(ValueError, match="tactile"):
        tactile(model, data.sensordata, "pad", 12, 16, 1e3)


def test_a_ball_on_a_tactile_sensor_is_read_where_it_reaches() -> None:
    x, y = np.meshgrid(np.linspace(-0.04, 0.04, 9), np.linspace(-0.03, 0.03, 5))
    places = " ".join(f"{a:g} {b:g} 0" for a, b in zip(x.ravel(), y.ravel(), strict=True))
    corners = (9 * r + c for r in range(4) for c in range(8))
    faces = " ".join(f"{k} {k + 1} {k + 9} {k + 1} {k + 10} {k + 9}" for k in corners)
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <asset><mesh name="taxels" vertex="{places}" face="{faces}" inertia="shell"/></asset>
      <worldbody>
        <body><geom name="pad" type="box" size="0.0001 0.03 0.04" quat="0 0.70711 0 0.70711"/></body>
        <body pos="0.01 -0.015 0.0202"><freejoint/><geom type="sphere" size="0.02" mass="0.4"/></body>
      </worldbody>
      <sensor><clock/><tactile name="pad" geom="pad" mesh="taxels"/></sensor>
    </mujoco>""")
    data = mujoco.MjData(model)
    skin = Skin(array={"rows": 5, "cols": 9})
    for _ in range(400):
        mujoco.mj_step(model, data)
    force = tactile(model, data.sensordata, "pad", 5, 9, 2e4)
    # MuJoCo turns a mesh to its main axes, the thin one first: the box is turned the same way.
    assert np.unravel_index(force.argmax(), force.shape) == (1, 5)
    assert force.max() == pytest.approx(2e4 * data.sensordata[1:46].max())
    found = skin.decode(skin.read(force))
    # Half a code of 15 N / 255.
    assert found.force_n == pytest.approx(force, abs=0.03)
    for rows, cols in ((9, 4), (5, 8)):
        with pytest.raises(ValueError, match="vertices"):
            tactile(model, data.sensordata, "pad", rows, cols, 2e3)
    with pytest.raises(ValueError, match="stiffness"):
        tactile(model, data.sensordata, "pad", 5, 9, 0.0)
