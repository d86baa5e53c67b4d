/* A camera like KITTI's, 1.65 m over the road: where the horizon is, and how far the ground is at rows straight ahead. */
#include <stdio.h>
#include <string.h>

#include "gedepth_core.h"

static int failed(const char *what, int32_t result) {
  if (result == GEDEPTH_CORE_OK) return 0;
  fprintf(stderr, "%s: %s (%d)\n", what, gedepth_core_result_text(result), (int)result);
  return 1;
}

enum { WIDTH = 1242, HEIGHT = 375 };

/* Static: the library allocates nothing. */
static gedepth_core_camera camera;
static float table[GEDEPTH_CORE_TABLE_LEN(WIDTH, HEIGHT)], metres[GEDEPTH_CORE_TABLE_LEN(WIDTH, HEIGHT)];

int main(void) {
  gedepth_core_lens lens;
  gedepth_core_mounting mounting;
  gedepth_core_line line;
  gedepth_core_ground ground;
  int row;

  if (gedepth_core_abi_version() != GEDEPTH_CORE_ABI_VERSION) return 1;

  memset(&lens, 0, sizeof lens);
  lens.width = WIDTH;
  lens.height = HEIGHT;
  lens.distortion = GEDEPTH_CORE_PINHOLE;
  lens.fx = lens.fy = 721.5377;
  lens.cx = 609.5593;
  lens.cy = 172.854;
  memset(&mounting, 0, sizeof mounting);
  mounting.height = 1.65;
  mounting.pitch = 0.01; /* radians, looking down */

  if (failed("lens", gedepth_core_camera_set_lens(&camera, &lens)) ||
      failed("mounting", gedepth_core_camera_set_mounting(&camera, &mounting)) ||
      failed("vanishing line", gedepth_core_vanishing_line(&camera, &line)) ||
      failed("table", gedepth_core_table_build(&camera, table, GEDEPTH_CORE_TABLE_LEN(WIDTH, HEIGHT), &ground)) ||
      failed("depth", gedepth_core_ground_depth(&ground, 80.0f, metres, GEDEPTH_CORE_TABLE_LEN(WIDTH, HEIGHT))))
    return 1;

  printf("vanishing line from (%.2f, %.2f) to (%.2f, %.2f)\n", line.u0, line.v0, line.u1, line.v1);
  for (row = 160; row < HEIGHT; row += 20) printf("row %d: %.3f m\n", row, metres[row * WIDTH + WIDTH / 2]);
  return 0;
}
