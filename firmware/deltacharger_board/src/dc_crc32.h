/* SPDX-License-Identifier: Apache-2.0 */
/* CRC-32 as in zlib, PNG and Ethernet: polynomial 0x04C11DB7 reflected, start and end inverted. */
#ifndef DC_CRC32_H
#define DC_CRC32_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Continue `crc` with `size` bytes and return the new CRC; start with 0. */
uint32_t dc_crc32(uint32_t crc, const uint8_t *bytes, size_t size);

#ifdef __cplusplus
}
#endif

#endif
