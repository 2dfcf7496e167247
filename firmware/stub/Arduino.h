/* SPDX-License-Identifier: Apache-2.0 */
/* Declares the calls of the OpenCM 9.04's Arduino core that the sketch uses, so that it compiles without that core.
 * Types as in ROBOTIS's board package 1.5.1. */
#ifndef ARDUINO_STUB_H
#define ARDUINO_STUB_H

#include <stddef.h>
#include <stdint.h>

#define LOW 0x0
#define HIGH 0x1
#define INPUT 0x0
#define OUTPUT 0x1
#define FALSE 0
#define TRUE 1

extern "C" {
uint32_t micros(void);
void delayMicroseconds(uint32_t us);
void pinMode(uint32_t pin, uint32_t mode);
void digitalWrite(uint32_t pin, uint32_t value);
int digitalRead(uint32_t pin);
void analogReadResolution(int bits);
uint32_t analogRead(uint32_t pin);
void analogWrite(uint32_t pin, uint32_t value);
uint32_t CDC_Itf_TxAvailable(void);
void drv_dxl_begin(uint8_t channel);
void drv_dxl_tx_enable(uint8_t channel, uint8_t enable);
}

struct UARTClass {
  void setDxlMode(bool dxl);
  void begin(uint32_t speed);
  int read(void);
  int availableForWrite(void);
  size_t write(const uint8_t *bytes, size_t size);
  void flush(void);
};

struct USBSerial {
  void begin(uint32_t speed);
  int available(void);
  int read(void);
  size_t write(const uint8_t *bytes, size_t size);
  operator bool();
};

extern UARTClass Serial1, Serial3;
extern USBSerial Serial;

/* Registers of the STM32F103. */
struct RCC_TypeDef {
  volatile uint32_t APB1ENR;
};
struct PWR_TypeDef {
  volatile uint32_t CR;
};
struct BKP_TypeDef {
  volatile uint32_t DR1;
};
struct IWDG_TypeDef {
  volatile uint32_t KR, PR, RLR;
};
extern RCC_TypeDef *const RCC;
extern PWR_TypeDef *const PWR;
extern BKP_TypeDef *const BKP;
extern IWDG_TypeDef *const IWDG;

const uint32_t RCC_APB1ENR_BKPEN = 1ul << 27;
const uint32_t RCC_APB1ENR_PWREN = 1ul << 28;
const uint32_t PWR_CR_DBP = 1ul << 8;

void setup(void);
void loop(void);

#endif
