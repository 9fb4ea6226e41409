function coulombus_world(address, seconds)
%COULOMBUS_WORLD  A wall from MATLAB: render it, and plot the handle.
%
%   In three terminals: coulombus emulate; coulombus run --world --mode hybrid; coulombus world
%   The last one prints the address:
%
%       coulombus_world("ws://127.0.0.1:8643/TOKEN/world", 10)
%
%   Needs MATLAB R2020b or later, and no toolbox: tcpclient, jsonencode and jsondecode are MATLAB's own.
%   MATLAB has no WebSocket client, so the functions below speak the part of RFC 6455 that is needed here:
%   no encryption, and one frame for each message.

if nargin < 2, seconds = 10; end
wall = struct("x_rad", 0.0, "K_Nm_rad", 2.0, "B_Nms_rad", 0.05);
[socket, rest] = connect(address);
closing = onCleanup(@() send(socket, 8, typecast(swapbytes(uint16(1000)), "uint8")));
send_json(socket, struct("type", "hello", "states", true));
figure; curve = animatedline; xlabel("t [s]"); ylabel("x [rad]");

start = tic; sent = -1; first_ns = []; lost = 0;
while toc(start) < seconds
    % A model lives for life_s: it is sent 50 times a second.
    if toc(start) - sent > 0.02
        sent = toc(start);
        send_json(socket, struct("type", "model", "law", 0, "life_s", 0.2, "wall", wall));
    end
    [messages, rest] = receive(socket, rest);
    for index = 1:numel(messages)
        message = jsondecode(messages{index});
        switch message.type
            case "welcome"
                fprintf("period %g ms\n", message.period_ns * 1e-6);
            case "refused"
                if ~message.again, error("coulombus:refused", "%s", message.reason); end
            case "states" % a list of each field, the oldest state first
                if isempty(first_ns), first_ns = message.t_ns(1); end
                addpoints(curve, (message.t_ns - first_ns) * 1e-9, message.x_rad);
                lost = message.lost(end);
        end
    end
    drawnow limitrate
    pause(0.002);
end
fprintf("%d states lost\n", lost);
end

function [socket, rest] = connect(address)
% Open the WebSocket at ws://HOST:PORT/PATH; `rest` are bytes behind the answer's head.
parts = regexp(char(address), "^ws://([^:/]+):(\d+)(/.*)$", "tokens", "once");
if isempty(parts), error("coulombus:address", "expected ws://HOST:PORT/PATH, got %s", address); end
socket = tcpclient(parts{1}, str2double(parts{2}), "Timeout", 10);
key = matlab.net.base64encode(uint8(randi([0 255], 1, 16)));
head = ["GET " + parts{3} + " HTTP/1.1", "Host: " + parts{1} + ":" + parts{2}, "Upgrade: websocket", ...
    "Connection: Upgrade", "Sec-WebSocket-Key: " + key, "Sec-WebSocket-Version: 13", "", ""];
write(socket, unicode2native(char(strjoin(head, char([13 10]))), "UTF-8"));
rest = uint8.empty(1, 0); last = [];
started = tic;
while isempty(last)
    if toc(started) > 10, error("coulombus:connect", "no answer from %s", address); end
    rest = [rest, arrived(socket)]; %#ok<AGROW>
    last = strfind(char(rest), char([13 10 13 10]));
end
answer = char(rest(1:last(1)));
if ~startsWith(answer, "HTTP/1.1 101"), error("coulombus:connect", "%s", strtok(answer, newline)); end
rest = rest(last(1) + 4:end);
end

function bytes = arrived(socket)
% Return the bytes that have arrived, without waiting.
bytes = uint8.empty(1, 0);
if socket.NumBytesAvailable > 0
    bytes = uint8(read(socket, socket.NumBytesAvailable, "uint8"));
    bytes = bytes(:).';
end
end

function send_json(socket, message)
send(socket, 1, unicode2native(jsonencode(message), "UTF-8"));
end

function send(socket, opcode, payload)
% Send a frame: final, masked as the RFC demands of a client.
mask = uint8(randi([0 255], 1, 4));
count = numel(payload);
if count < 126
    head = uint8([128 + opcode, 128 + count]);
else
    head = [uint8([128 + opcode, 128 + 126]), typecast(swapbytes(uint16(count)), "uint8")];
end
masks = repmat(mask, 1, ceil(count / 4));
write(socket, [head, mask, bitxor(uint8(payload), masks(1:count))]);
end

function [messages, rest] = receive(socket, rest)
% Return the whole text messages among the bytes that have arrived, and the bytes behind them.
rest = [rest, arrived(socket)];
messages = {};
while numel(rest) >= 2
    count = double(bitand(rest(2), 127)); head = 2;
    wide = (count == 126) * 2 + (count == 127) * 8; % bytes of the length
    if numel(rest) < head + wide, return; end
    if wide > 0, count = double(rest(3:2 + wide)) * 256 .^ (wide - 1:-1:0).'; head = 2 + wide; end
    if numel(rest) < head + count, return; end
    opcode = bitand(rest(1), 15); payload = rest(head + 1:head + count);
    rest = rest(head + count + 1:end);
    switch opcode
        case 1
            messages{end + 1} = native2unicode(payload, "UTF-8"); %#ok<AGROW>
        case 8
            error("coulombus:closed", "closed: %s", native2unicode(payload(3:end), "UTF-8"));
        case 9
            send(socket, 10, payload);
    end
end
end
