/* SPDX-License-Identifier: Apache-2.0 */
#include "dermis_host.h"

#include "dermis_registers.h"

enum { OP_WRITE = 0x02, OP_READ = 0x03, OP_FRAME = 0x0B, TOKEN_DONE = 0x5A, TOKEN_DATA = 0xA5, TOKEN_FRAME = 0x3C };

static uint8_t crc8(const uint8_t *bytes, size_t count) {
  uint8_t crc = 0;
  while (count--) {
    crc ^= *bytes++;
    for (int bit = 0; bit < 8; bit++) crc = (uint8_t)(crc << 1 ^ (crc & 0x80 ? 0x07 : 0));
  }
  return crc;
}

static uint16_t crc16(const uint8_t *bytes, size_t count) {
  uint16_t crc = 0xFFFF;
  while (count--) {
    crc = (uint16_t)(crc ^ *bytes++ << 8);
    for (int bit = 0; bit < 8; bit++) crc = (uint16_t)(crc << 1 ^ (crc & 0x8000 ? 0x1021 : 0));
  }
  return crc;
}

/* A frame with its CRC, of whole slots in order: the special ones, then rows. Zeros follow an answer and keep a CRC of 0,
   so that a frame whose length was corrupted upwards is whole with them: what is whole without its zeros is refused,
   unless its length is sure, because it came twice. */
static int whole(const uint8_t *bytes, size_t length, int sure) {
  size_t slot = 1u + bytes[4] * (bytes[5] > 8 ? 2u : 1u) + (bytes[4] + 7u) / 8u, used = length;
  int last = -1;
  if (bytes[0] != 1 || bytes[1] >> 5 || length == 10 || (length - 10) % slot) return 0;
  if (!bytes[4] || bytes[4] > 128 || !bytes[5] || bytes[5] > 16) return 0;
  for (size_t at = 8; at < length - 2; at += slot) {
    int order = bytes[at] >= 0xF0 && bytes[at] <= 0xF3 ? bytes[at] - 0xF0 : bytes[at] < 128 ? bytes[at] + 4 : -1;
    if (order <= last) return 0;
    last = order;
  }
  while (used && !bytes[used - 1]) used--;
  for (size_t end = 10 + slot; !sure && end < length; end += slot)
    if (end >= used && !crc16(bytes, end)) return 0;
  return 1;
}

static int exchange(const dermis_host *host, const uint8_t *send, uint8_t *receive, size_t count) {
  while (count) {
    size_t now = host->transfer_bytes && host->transfer_bytes < count ? host->transfer_bytes : count;
    if (host->transfer(host->port, send, receive, now, 1)) return DERMIS_PORT;
    if (send) send += now;
    receive += now;
    count -= now;
  }
  return DERMIS_OK;
}

static int refusal(uint8_t token) {
  if (token == 0xE1 || token == 0xE2) return DERMIS_NOT_WRITTEN;
  return token == 0xE0 || token == 0xE3 ? DERMIS_NO_REGISTER : DERMIS_BAD_TOKEN;
}

/* Send a command and wait for the token of its answer; `command` is overwritten. */
static int ask(const dermis_host *host, uint8_t *command, size_t count, uint8_t wanted) {
  uint8_t token = 0;
  int status = exchange(host, command, command, count);
  if (status != DERMIS_OK) return status;
  /* A wrong opcode is answered before this command is over: as unknown, or as a shorter one, which wrote nothing. */
  for (size_t n = 0; n < count; n++)
    if (command[n] == TOKEN_DATA || command[n] == TOKEN_FRAME) return DERMIS_NOT_WRITTEN;
    else if (command[n]) return refusal(command[n]);
  for (unsigned n = 0; status == DERMIS_OK && token == 0; n++) {
    if (n > host->wait_bytes) return DERMIS_NO_ANSWER;
    status = exchange(host, NULL, &token, 1);
  }
  return status != DERMIS_OK || token == wanted ? status : refusal(token);
}

/* Release chip select; the chip ignores a byte after its answer. */
static int finish(const dermis_host *host, int status) {
  uint8_t byte;
  int failed = host->transfer(host->port, NULL, &byte, 1, 0);
  return status == DERMIS_OK && failed ? DERMIS_PORT : status;
}

static int corrupted(int status) {
  return status == DERMIS_BAD_TOKEN || status == DERMIS_NO_REGISTER || (status >= DERMIS_NOT_WRITTEN && status <= DERMIS_BAD_LENGTH);
}

int dermis_write(const dermis_host *host, uint8_t address, uint16_t value) {
  int status = DERMIS_NOT_WRITTEN;
  /* Not after a bad token: the chip may have written, and a shot would be taken twice. */
  for (unsigned n = 0; (!n || n < host->tries) && (status == DERMIS_NOT_WRITTEN || status == DERMIS_NO_REGISTER); n++) {
    uint8_t command[5] = {OP_WRITE, address, (uint8_t)(value >> 8), (uint8_t)value, 0};
    command[4] = crc8(command, 4);
    status = finish(host, ask(host, command, 5, TOKEN_DONE));
  }
  return status;
}

int dermis_read(const dermis_host *host, uint8_t address, uint16_t *value) {
  int status = DERMIS_BAD_CRC;
  for (unsigned n = 0; (!n || n < host->tries) && corrupted(status); n++) {
    uint8_t command[2] = {OP_READ, address}, answer[5] = {OP_READ, address, 0, 0, 0};
    status = ask(host, command, 2, TOKEN_DATA);
    if (status == DERMIS_OK) status = exchange(host, NULL, answer + 2, 3);
    if (status == DERMIS_OK && crc8(answer, 5)) status = DERMIS_BAD_CRC;
    status = finish(host, status);
    *value = (uint16_t)(answer[2] << 8 | answer[3]);
  }
  return status;
}

int dermis_set_up(const dermis_host *host, const uint16_t (*settings)[2], size_t count) {
  uint16_t id;
  int status = dermis_read(host, DERMIS_ID, &id);
  if (status == DERMIS_OK && id != 0xDE01) status = DERMIS_OTHER_CHIP;
  for (size_t n = 0; n < count && status == DERMIS_OK; n++)
    status = dermis_write(host, (uint8_t)settings[n][0], settings[n][1]);
  return status;
}

int dermis_check(const dermis_host *host, const uint16_t (*settings)[2], size_t count) {
  int status = DERMIS_OK;
  for (size_t n = 0; n < count && status == DERMIS_OK; n++) {
    uint16_t value;
    status = dermis_read(host, (uint8_t)settings[n][0], &value);
    if (status == DERMIS_OK && value != settings[n][1]) status = DERMIS_WAS_RESET;
  }
  return status;
}

int dermis_wait(const dermis_host *host, uint16_t mask, unsigned polls) {
  uint16_t value;
  while (polls--) {
    int status = dermis_read(host, DERMIS_STATUS, &value);
    if (status != DERMIS_OK || value & mask) return status;
  }
  return DERMIS_TIMEOUT;
}

int dermis_frame(const dermis_host *host, unsigned polls, uint8_t *bytes, size_t room, size_t *length) {
  int status = dermis_wait(host, DERMIS_STATUS_FRAME_READY_MASK, polls);
  size_t before = 0;
  if (status != DERMIS_OK) return status;
  status = DERMIS_BAD_CRC;
  for (unsigned n = 0; (!n || n < host->tries) && corrupted(status); n++) {
    uint8_t command[1] = {OP_FRAME}, size[2] = {0, 0};
    status = ask(host, command, 1, TOKEN_FRAME);
    if (status == DERMIS_OK) status = exchange(host, NULL, size, 2);
    *length = (size_t)(size[0] << 8 | size[1]);
    if (status == DERMIS_OK && (*length < 10 || *length > room)) status = DERMIS_BAD_LENGTH;
    if (status == DERMIS_OK) status = exchange(host, NULL, bytes, *length);
    if (status == DERMIS_OK && crc16(bytes, *length)) status = DERMIS_BAD_CRC;
    if (status == DERMIS_OK && !whole(bytes, *length, *length == before)) status = DERMIS_BAD_LENGTH;
    before = *length;
    status = finish(host, status);
  }
  return status;
}
