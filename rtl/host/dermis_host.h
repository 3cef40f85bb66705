/* SPDX-License-Identifier: Apache-2.0 */
/* Host of the chip for microcontrollers: registers and frames over SPI (docs/spi.md). C99, no allocation. */
#ifndef DERMIS_HOST_H
#define DERMIS_HOST_H

#include <stddef.h>
#include <stdint.h>

enum {
  DERMIS_OK,
  DERMIS_PORT,          /* the transfer callback failed */
  DERMIS_NO_ANSWER,     /* only wait bytes: no clock, no chip, CIPO stuck at 0 */
  DERMIS_BAD_TOKEN,     /* not a token: wrong mode, bit slip, CIPO stuck at 1 */
  DERMIS_NO_REGISTER,   /* E3, or E0: nothing was done */
  DERMIS_NOT_WRITTEN,   /* E1 or E2 in each try, or taken for a read: nothing was done */
  DERMIS_BAD_CRC,       /* in each try */
  DERMIS_BAD_LENGTH,    /* longer than the buffer, or no header or whole slots in order */
  DERMIS_TIMEOUT,       /* STATUS did not show the bit */
  DERMIS_OTHER_CHIP,    /* ID is not DE01 */
  DERMIS_WAS_RESET      /* a register is not as it was set up */
};

typedef struct {
  /* Exchange `count` bytes, 0xFF if `send` is NULL; chip select, low from the first byte on, stays
     low afterwards if `hold`. Mode 0, most significant bit first. Return 0 when done. */
  int (*transfer)(void *port, const uint8_t *send, uint8_t *receive, size_t count, int hold);
  void *port;
  size_t transfer_bytes; /* most bytes of one transfer; 0: no limit */
  unsigned wait_bytes;   /* most wait bytes before an answer; 4096 is SCK at 8000 times f_clk */
  unsigned tries;        /* of a request that the line corrupted; 3, and at least one is made */
} dermis_host;

/* Each returns one of the above. */
int dermis_read(const dermis_host *host, uint8_t address, uint16_t *value);
int dermis_write(const dermis_host *host, uint8_t address, uint16_t value);

/* Check ID, then write `count` pairs of address and value. */
int dermis_set_up(const dermis_host *host, const uint16_t (*settings)[2], size_t count);

/* Read registers back; a chip that was reset in operation has its reset values, and its frame number began
   again at 1. So does a register seem to have that was given more bits than it has, or a pulse. */
int dermis_check(const dermis_host *host, const uint16_t (*settings)[2], size_t count);

/* Read STATUS until a bit of `mask` is set, at most `polls` times. */
int dermis_wait(const dermis_host *host, uint16_t mask, unsigned polls);

/* Wait for a new frame and read it, again after a bad CRC: `length` bytes as in docs/spi.md. */
int dermis_frame(const dermis_host *host, unsigned polls, uint8_t *bytes, size_t room, size_t *length);

#endif
