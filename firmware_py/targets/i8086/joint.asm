; The joint CPU's control step and the control interrupt around it, for the 8086.
;
; The step is firmware_py/joint_cpu.py's, make_step, operation by operation in words of the default format: signals in
; 16 bits, the disturbance estimate d in 32 (Q15.16), sums and products in 32. Each comment below that begins with a
; name is that line of Python. Nothing here is code of the robot of the 1990s: that is not known to us.
;
;     nasm -f bin -o joint.bin -l joint.lst joint.asm
;
; Rounding: every shift floors, but for the reference current, which is rounded to the nearest, halves up.
; Undefined flags are never asked: IMUL leaves CF and OF alone defined, and shifts OF by one bit only.
; The data segment has nothing but what is declared here, so DS is never loaded; words lie at even addresses, where
; the 8086 fetches them in one bus cycle. CS is another segment. Names of bits in comments: high = DX or the high word.
;
; Ref: S. Komada, M. Ishida, T. Hori, eqs. (5), (6), (8), table 1; Intel 8086 Family User's Manual 1979.

        cpu     8086
        bits    16

ENCODER equ     10h                     ; position counter, u16         these ports stand in
DAC     equ     12h                     ; current reference, i16        for the CAN controller
PIC     equ     20h                     ; interrupt controller
END_OF_INTERRUPT equ 20h

; ------------------------------------------------------------------------------------------------ data, from DS:0 on
        absolute 0

count_prev:     resw    1               ; u16   state: position counter of the sample before
w_prev:         resw    1               ; Q15.0 state: its speed
d:              resw    2               ; Q15.16 state: disturbance estimate, low word first
a_ref:          resw    1               ; Q15.0 acceleration reference, put here by whoever received it
ka:             resw    1               ; Q0.15 the table of parameters
kb:             resw    1               ; Q15.0
kj:             resw    1               ; Q.shift
shift:          resw    1               ; 0 to 32767
current_limit:  resw    1               ; Q15.0, above -32768

i:              resw    1               ; Q15.0 answer: current reference
estimate:       resw    1               ; Q15.0 answer: the d that it answers

kb_dw_over:     resw    1               ; u16, wrap: saturations by signal
d_over:         resw    1
i_over:         resw    1
error_over:     resw    1

; ------------------------------------------------------------------------------------------------ code, from CS:0 on
        section .text
        org     0

        dw      interrupt, step, saturating     ; where to enter; where the straight line ends

; Entered through the vector of the encoder's interrupt, interrupts off. Keeps all registers.
interrupt:
        push    ax
        push    bx
        push    cx
        push    dx
        push    di
        in      ax,ENCODER
        call    step
        mov     ax,[i]
        out     DAC,ax
        mov     al,END_OF_INTERRUPT
        out     PIC,al
        pop     di
        pop     dx
        pop     cx
        pop     bx
        pop     ax
        iret

; The control step: AX = count; 3 multiplications, 6 additions. Loses AX, BX, CX, DX, DI.
; Where nothing saturates and shift is 16 or less, all but the loop is one straight line: what is rare is behind it.
step:
; w = wrap(count - count_prev)                                                  addition 1
        mov     bx,ax
        sub     ax,[count_prev]
        mov     [count_prev],bx
; dw = wrap(w - w_prev)                                                         addition 2
        mov     bx,ax
        sub     ax,[w_prev]
        mov     [w_prev],bx
; from_speed = saturate(kb * dw)                                                multiplication 1
        imul    word [kb]
        jo      kb_dw_saturates         ; DX is not AX's sign
speed:
; d = saturate_d(d - (from_speed << 16))                                        addition 3, on d's high word alone
        mov     di,[d+2]
        sub     di,ax
        jo      d_saturates
; estimate = high(d)                                                            kept in DI
estimated:
        mov     [estimate],di
; feed = kj * a, shifted right and rounded                                      multiplication 2
        mov     ax,[a_ref]
        imul    word [kj]
        mov     bx,dx                   ; 48 bits BX:DX:AX, BX the sign:
        shl     bx,1
        sbb     bx,bx
        mov     cx,16                   ; right by shift is left by 16 - shift, and AX falls off
        sub     cx,[shift]
        je      round
        jb      shift_far
shift_left:
        shl     ax,1
        rcl     dx,1
        rcl     bx,1
        dec     cx
        jne     shift_left
round:
        shl     ax,1                    ; carry: the last bit shifted out
shifted:
        adc     dx,cx                   ; CX is 0
        adc     bx,cx
; i = limit(feed + estimate)                                                    addition 4, 32 bits
        mov     cx,dx
        mov     ax,di
        cwd
        add     ax,cx
        adc     dx,bx
        mov     bx,dx
        cwd
        cmp     dx,bx
        jne     i_far                   ; the sum is no word
        mov     bx,[current_limit]
        cmp     ax,bx
        jg      i_over_limit
        neg     bx
        cmp     ax,bx
        jl      i_over_limit
limited:
        mov     [i],ax
; error = saturate(i - estimate)                                                addition 5
        sub     ax,di
        jo      error_saturates
; d = saturate_d(d + (ka * error << 1))                                         multiplication 3, addition 6
deviated:
        imul    word [ka]
        mov     cx,[d]
        add     cx,ax                   ; twice in place of once doubled, which 33 bits may need: -32768 * -32768;
        adc     di,dx                   ; both have one sign, so what is over stays over
        jo      d_saturates_at_last
        add     cx,ax
        adc     di,dx
        jo      d_saturates_at_last
        mov     [d],cx
stored:
        mov     [d+2],di
        ret

; ------------------------------------------------------------------------------------------------ where it saturates
saturating:

; The product's sign is DX's: 7FFFh or 8000h.
kb_dw_saturates:
        inc     word [kb_dw_over]
        mov     ax,dx
        cwd
        mov     ax,dx
        xor     ax,7FFFh
        jmp     speed

; DI wrapped, so its sign is the wrong one: DX = FFFFh, d = 7FFF:FFFFh, or DX = 0, d = 8000:0000h.
d_saturates:
        call    saturate_d
        jmp     estimated

d_saturates_at_last:
        call    saturate_d
        jmp     stored

saturate_d:
        inc     word [d_over]
        mov     ax,di
        cwd
        mov     [d],dx
        mov     ax,dx
        xor     ax,8000h
        mov     di,ax
        ret

; Right by more than 16: AX is gone, and DX goes on; more than 32 shifts leave what 32 do.
shift_far:
        neg     cx
        cmp     cx,17
        jb      shift_right
        mov     cx,16
shift_right:
        sar     dx,1
        dec     cx                      ; DEC leaves the carry alone
        jne     shift_right
        jmp     shifted

; BX has the sum's sign.
i_far:
        mov     ax,[current_limit]
        cmp     bx,0
        jge     i_limited
        neg     ax
        jmp     i_limited

; BX is the limit that was passed, or its opposite.
i_over_limit:
        mov     ax,bx
i_limited:
        inc     word [i_over]
        jmp     limited

; AX wrapped, so its sign is the wrong one.
error_saturates:
        inc     word [error_over]
        cwd
        mov     ax,dx
        xor     ax,8000h
        jmp     deviated
